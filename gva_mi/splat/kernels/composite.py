"""Compositing of all channels, forward, adjoint and tangent, and what a forward pass keeps.

D channels are composited a few at a time, by one kernel (blend.py) for all of these *chunks*. It
holds every pixel's channels in registers and is compiled for their number. Beyond ``CHUNK``
channels the same lists are composited once per chunk, the last one padded with zeros: time grows
linearly with D. The first chunk also has the depth. The moments of eq. 16 are linear in the loss's
gradient, so those of the chunks add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.jit.frozen import Frozen
from gva_mi.jit.packets import Packets
from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels.blend import blend, blend_adjoint, blend_tangent
from gva_mi.splat.kernels.inputs import (
    CameraArrays,
    GradientMemory,
    Inputs,
    Plan,
    RequestedGradients,
)
from gva_mi.splat.kernels.project import ProjectedMemory
from gva_mi.splat.kernels.records import PairGradient, RecordFormat, Splat
from gva_mi.splat.kernels.tile_memory import Limit, Planes, SavedPixels
from gva_mi.splat.kernels.tiles import Grid, Layout, Lists, capacity, walked


@dataclass(frozen=True)
class SavedState:
    """A picture, with the forward pass's state that its adjoint and tangent need."""

    inputs: Inputs
    plan: Plan
    camera: Camera
    view: CameraArrays
    background: list[Array]  # D
    layout: Layout
    grid: Grid
    planes: Planes
    projected: ProjectedMemory | None  # None if there is no Gaussian
    lists: Lists | None  # None if none is drawn
    saved_pixels: SavedPixels | None
    stop: Array | None  # where each lane of blend stopped

    def backgrounds(self) -> list[list[Array]]:
        """The background of each chunk."""
        return split_background(self.background, self.plan.formats)


@dataclass(frozen=True)
class Gradients:
    """Result of :func:`render_adjoint`; None for a gradient that was not requested."""

    gaussians: GradientMemory
    background: list[float]  # D
    T_camera_world: np.ndarray | None  # (4, 4)
    K: np.ndarray | None  # (3, 3)

    def named(self) -> Iterator[tuple[str, Array]]:
        """Yield the gradients by the Gaussians' arrays that were requested, by name."""
        g = self.gaussians
        parts = {"means": g.means, "opacities": g.opacities, "colors": g.colors}
        parts |= {} if g.geometry is None else vars(g.geometry)
        yield from ((name, array) for name, array in parts.items() if array is not None)


CHUNK = 8  # channels composited at a time


def chunk_formats(channels: int, depth: bool, whole: bool = False) -> tuple[RecordFormat, ...]:
    """Return the format of each chunk's splats, padding included.

    Args:
        channels: D.
        depth: whether the depth is composited too.
        whole: make one chunk of all channels.
    """
    if whole or channels <= CHUNK:
        return (RecordFormat(channels, depth),)
    return tuple(RecordFormat(CHUNK, depth and k == 0) for k in range(-(-channels // CHUNK)))


def split_splat(splat: Splat, formats: tuple[RecordFormat, ...]) -> list[Splat]:
    """Split a splat: the same ellipse in every chunk, some of the channels each."""
    out, first = [], 0
    for format in formats:
        color = splat.color[first : first + format.channels]
        color = [*color, *([splat.depth * 0] * (format.channels - len(color)))]
        out.append(replace(splat, color=color, depth=splat.depth if format.depth else None))
        first += format.channels
    return out


def split_background(
    background: list[Array], formats: tuple[RecordFormat, ...]
) -> list[list[Array]]:
    """Split the background's channels into chunks."""
    F, total = type(background[0]), sum(format.channels for format in formats)
    rest = background + [dr.opaque(F, 0) for _ in range(total - len(background))]
    out = []
    for format in formats:
        out.append(rest[: format.channels])
        rest = rest[format.channels :]
    return out


@Frozen
def join(parts: list[Array], alpha: Array, whole: Array, *, channels: int) -> Array:
    """Join the planes of the chunks to one of ``channels``."""
    pixel = dr.arange(dr.uint32_array_t(type(alpha)), dr.width(alpha))
    for c in range(channels):
        value = dr.gather(type(alpha), parts[c // CHUNK], pixel * CHUNK + c % CHUNK)
        dr.scatter(whole, value, pixel * channels + c, mode=dr.ReduceMode.NoConflicts)
    dr.eval(whole)
    return whole


@Frozen
def split(whole: Array, nothing: Array, parts: list[Array], *, channels: int) -> list[Array]:
    """Reverse of :func:`join`; ``nothing`` is a zero for each pixel."""
    pixel = dr.arange(dr.uint32_array_t(type(nothing)), dr.width(nothing))
    for c in range(CHUNK * len(parts)):
        value = nothing * 1
        if c < channels:
            value = dr.gather(type(whole), whole, pixel * channels + c)
        part = parts[c // CHUNK]
        dr.scatter(part, value, pixel * CHUNK + c % CHUNK, mode=dr.ReduceMode.NoConflicts)
    dr.eval(parts)
    return parts


def join_planes(parts: list[Planes], channels: int) -> Planes:
    """Join the pictures of the chunks."""
    if len(parts) == 1:
        return parts[0]
    alpha = parts[0].alpha
    whole = packets.memory(type(alpha), dr.width(alpha) * channels)
    color = join([part.color for part in parts], alpha, whole, channels=channels)
    return Planes(color, alpha, parts[0].depth)


def split_gradient(grad: Planes, channels: int, parts: int) -> list[Planes]:
    """Split the picture's gradient into chunks; the first has alpha's and depth's."""
    if parts == 1:
        return [grad]
    F, size = type(grad.color), dr.width(grad.color) // channels
    memory = [packets.memory(F, size * CHUNK) for _ in range(parts)]
    nothing = dr.opaque(F, 0, size)
    colors = split(grad.color, nothing, memory, channels=channels)
    rest = [Planes(color, None, None) for color in colors[1:]]
    return [Planes(colors[0], grad.alpha, grad.depth), *rest]


def add_slots(parts: list[PairGradient], channels: int) -> PairGradient:
    """Add the slots of the chunks to one of D channels."""
    first = parts[0]
    if len(parts) == 1:
        return first
    color = [channel for part in parts for channel in part.color][:channels]
    rows = zip(*(replace(part, color=[], depth=None).pack() for part in parts), strict=True)
    sums = [sum(row[1:], row[0]) for row in rows]
    format = RecordFormat(0, False, bool(first.absolute), first.m0 is not None)
    return replace(PairGradient.unpack(sums, format), color=color, depth=first.depth)


def composite(
    splats: list[Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    pixels: int,
    plan: Plan,
) -> tuple[Planes, SavedPixels, Array]:
    """Return the picture, its ``SavedPixels``, and where in ``lists.ids`` each lane stopped.

    Planes hold the picture's pixels first; there may be unused memory behind them.

    Args:
        splats: one entry per chunk.
        lists, grid, limit: as ``blend`` takes them.
        background: D arrays of size one.
        pixels: of the picture, padded to whole tiles.
        plan: formats of the chunks, and cut-offs.
    """
    pictures, size = [], capacity(pixels)  # few sizes for the boxes of a video: few recordings
    behind, options = split_background(background, plan.formats), plan.options
    for part, colors, format in zip(splats, behind, plan.formats, strict=True):
        picture, saved_pixels, stop = blend(
            part, lists, grid, colors, limit, pixels=size, format=format, options=options
        )
        pictures.append(picture)
    return join_planes(pictures, len(background)), saved_pixels, stop


def composite_adjoint(
    saved: SavedState, grad: Planes, requested: RequestedGradients
) -> tuple[list[Packets], tuple[RecordFormat, ...], list[Array]]:
    """Return the slots of each chunk, their formats, and each lane's gradient by the background.

    Args:
        saved: the forward pass.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        requested: what the slots must hold: the moments are for geometry.
    """
    plan, D = saved.plan, len(saved.background)
    colors = requested.colors or plan.harmonics  # harmonics reach the means too
    slots, slot_formats, by_background = [], [], []
    lists = walked(saved.lists, saved.stop)
    pictures = split_gradient(grad, D, len(plan.formats))
    parts = zip(saved.projected.splats, pictures, saved.backgrounds(), plan.formats, strict=True)
    for part, by_picture, behind, format in parts:
        depth = by_picture.depth is not None and requested.geometry
        slot_format = RecordFormat(
            format.channels if colors else 0, depth, requested.absolute, requested.geometry
        )
        memory, shares = blend_adjoint(
            part,
            lists,
            saved.grid,
            behind,
            saved.saved_pixels,
            by_picture,
            pairs=dr.width(lists.ids),
            lanes=dr.width(lists.tile),
            format=format,
            slot_format=slot_format,
            options=plan.options,
        )
        slots.append(memory)
        slot_formats.append(slot_format)
        by_background.append(shares)
    return slots, tuple(slot_formats), by_background


def composite_tangent(
    saved: SavedState, dsplats: list[Packets], dbackground: list[Array]
) -> Planes:
    """Return the tangent of the picture.

    Args:
        saved: the forward pass.
        dsplats: tangents of the splats, one entry per chunk.
        dbackground: of the background, D arrays of size one.
    """
    plan, pictures = saved.plan, []
    dbehind = split_background(dbackground, plan.formats)
    parts = zip(saved.projected.splats, dsplats, saved.backgrounds(), dbehind, strict=True)
    of_all = (saved.lists, saved.stop, saved.saved_pixels, saved.grid)
    for (splats, dpart, colors, dcolors), format in zip(parts, plan.formats, strict=True):
        constants = {"pixels": capacity(saved.layout.pixels), "options": plan.options}
        picture = blend_tangent(splats, dpart, *of_all, colors, dcolors, format=format, **constants)
        pictures.append(picture)
    return join_planes(pictures, plan.channels)


def background_gradient(by_lanes: list[Array], plan: Plan) -> list[float]:
    """Add up the lanes' gradients by the background, (D,), when all kernels have ended."""
    parts = zip(by_lanes, plan.formats, strict=True)
    sums = [sum_rows(shares, format.channels) for shares, format in parts]
    return np.concatenate(sums)[: plan.channels].tolist()


def sum_rows(flat: Array, width: int, rows: int | None = None) -> np.ndarray:
    """Add up the first ``rows`` rows of a flat array, or all, on the host.

    numpy adds in one thread, in float64: the same bits for any number of threads. Column by
    column, because it takes ten times as long for all at once.
    """
    columns = flat.numpy().reshape(-1, width)[:rows].T
    return np.array([column.sum(dtype=np.float64) for column in columns])
