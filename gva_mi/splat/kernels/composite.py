"""Compositing of all chunks of the channels, its adjoint and tangent: blend.py, once per chunk."""

from __future__ import annotations

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit.packets import Packets
from gva_mi.splat.kernels import chunks
from gva_mi.splat.kernels.blend import blend, blend_adjoint, blend_tangent
from gva_mi.splat.kernels.inputs import Plan, RequestedGradients
from gva_mi.splat.kernels.planes import Limit, Planes, SavedPixels
from gva_mi.splat.kernels.records import RecordFormat
from gva_mi.splat.kernels.saved import SavedState
from gva_mi.splat.kernels.tiles import Grid, Lists, capacity, walked


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
    behind, options = chunks.split_background(background, plan.formats), plan.options
    for part, colors, format in zip(splats, behind, plan.formats, strict=True):
        picture, saved_pixels, stop = blend(
            part, lists, grid, colors, limit, pixels=size, format=format, options=options
        )
        pictures.append(picture)
    return chunks.join_planes(pictures, len(background)), saved_pixels, stop


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
    pictures = chunks.split_gradient(grad, D, len(plan.formats))
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
    dbehind = chunks.split_background(dbackground, plan.formats)
    parts = zip(saved.projected.splats, dsplats, saved.backgrounds(), dbehind, strict=True)
    of_all = (saved.lists, saved.stop, saved.saved_pixels, saved.grid)
    for (splats, dpart, colors, dcolors), format in zip(parts, plan.formats, strict=True):
        constants = {"pixels": capacity(saved.layout.pixels), "options": plan.options}
        picture = blend_tangent(splats, dpart, *of_all, colors, dcolors, format=format, **constants)
        pictures.append(picture)
    return chunks.join_planes(pictures, plan.channels)


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
