"""The three passes over the kernels: forward, adjoint and tangent.

    render_forward:   project  ->  tiles.make_lists  ->  blend
    render_adjoint:   project_adjoint  <-  sum_slots  <-  blend_adjoint
    render_tangent:   project_tangent  ->  blend_tangent

drjit_render.py wraps them for Dr.Jit's autodiff, torch_passes.py for torch's tensors. Pictures are
*planes* here: flat arrays, padded to whole tiles.

The kernels are frozen (frozen.py). The first call traces and compiles them (0.1-0.5 s each, cached
on disk). Later calls replay them for any number of Gaussians, pose and cut-off of distance or size
(near, far, blur, radius). Keyword arguments are constants of a recording: another value makes
another recording. So do a pixel's cut-offs and the number of channels, which change the kernel too.
The size of memory that a kernel allocates itself only makes it trace again. It is a *capacity*
(``tiles.capacity``), because numbers of Gaussians, pairs and pixels change often. Memory passed as
an argument would be copied at every call.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.jit.frozen import Frozen
from gva_mi.splat.camera import ArgumentError, Camera
from gva_mi.splat.kernels import chunks, tiles
from gva_mi.splat.kernels.blend import blend, blend_adjoint, blend_tangent, sum_slots
from gva_mi.splat.kernels.inputs import (
    CameraArrays,
    GradientMemory,
    Inputs,
    Plan,
    RequestedGradients,
    camera_adjoint,
    camera_arrays,
    camera_tangent,
)
from gva_mi.splat.kernels.project import ProjectedMemory, project, project_adjoint, project_tangent
from gva_mi.splat.kernels.records import (
    CameraGradient,
    Footprint,
    PairGradient,
    RecordFormat,
    Splat,
)
from gva_mi.splat.kernels.tile_memory import Limit, Planes, SavedPixels
from gva_mi.splat.kernels.tiles import Grid, Layout, Lists
from gva_mi.splat.options import SplatOptions


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
    planes: Planes  # the picture comes first; there may be unused memory behind it
    projected: ProjectedMemory | None  # None without Gaussians
    lists: Lists | None  # None if no Gaussian is drawn
    saved_pixels: SavedPixels | None
    stop: Array | None  # where each lane of blend stopped

    def backgrounds(self) -> list[list[Array]]:
        """The background of each chunk."""
        return chunks.split_background(self.background, self.plan.formats)


@dataclass(frozen=True)
class Gradients:
    """Result of :func:`render_adjoint`; None for a gradient that was not requested."""

    gaussians: GradientMemory
    background: list[float]  # D
    T_camera_world: np.ndarray | None  # (4, 4)
    K: np.ndarray | None  # (3, 3)

    def named(self) -> Iterator[tuple[str, Array]]:
        """Yield the requested gradients of the Gaussians' arrays, by name."""
        g = self.gaussians
        parts = {"means": g.means, "opacities": g.opacities, "colors": g.colors}
        parts |= {} if g.geometry is None else vars(g.geometry)
        yield from ((name, array) for name, array in parts.items() if array is not None)


def render_forward(
    inputs: Inputs,
    harmonics: bool,
    camera: Camera,
    options: SplatOptions,
    background: list[float],
    absolute: bool = False,
    limit: Array | None = None,
) -> SavedState:
    """Draw the picture into ``.planes``, padded to whole tiles.

    Args:
        inputs: flat arrays of one precision, of consistent widths.
        harmonics: whether ``inputs.colors`` holds coefficients rather than D channels.
        camera: the view.
        options: cut-offs.
        background: one number per channel.
        absolute: whether the absolute gradient will be requested, which forbids splitting the
            channels into chunks.
        limit: m, a plane; a pixel shows only the Gaussians nearer than its number.

    Raises:
        ValueError: an input is NaN or infinite, or there are too many pairs to count.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise ValueError("render(): its kernels are frozen already: do not call it in dr.freeze")
    if not np.isfinite(background).all():
        raise ArgumentError("render()", "background", f"must be finite, got {background}")
    F, D = inputs.float_type, len(background)
    layout, view = Layout(camera.width, camera.height), camera_arrays(camera, options)
    grid = layout.grid(dr.int32_array_t(F))
    behind = [dr.opaque(F, b) for b in background]
    formats = chunks.formats(D, options.depth, whole=absolute)
    plan = Plan(options.kernel_constants(), harmonics, inputs.color_width, D, formats)
    projected = lists = saved_pixels = stop = None
    if len(inputs):
        projected = _project_checked(inputs, plan, view, grid)
        found = projected.footprints, projected.depths, projected.counts
        lists = tiles.make_lists(*found, layout, grid)
    if lists is None:
        planes = Planes.of_background(behind, layout.pixels, options.depth)
    else:
        far = None if limit is None else Limit(limit, projected.depths)
        planes, saved_pixels, stop = _composite(
            projected.splats, lists, grid, behind, far, layout.pixels, plan
        )
    return SavedState(
        inputs=inputs,
        plan=plan,
        camera=camera,
        view=view,
        background=behind,
        layout=layout,
        grid=grid,
        planes=planes,
        projected=projected,
        lists=lists,
        saved_pixels=saved_pixels,
        stop=stop,
    )


def _project_checked(inputs: Inputs, plan: Plan, view: CameraArrays, grid: Grid) -> ProjectedMemory:
    """Project the Gaussians and check that all their numbers are finite."""
    projected = project_gaussians(inputs, view, grid, rows=tiles.capacity(len(inputs)), plan=plan)
    if not dr.all(projected.finite):
        inputs.require_finite(plan.harmonics)
    return projected


def render_adjoint(saved: SavedState, grad: Planes, requested: RequestedGradients) -> Gradients:
    """Reverse of :func:`render_forward`.

    Args:
        saved: what it returned, drawn with ``absolute`` if the absolute gradient is requested.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        requested: the gradients to return; what only others need is not computed.
    """
    plan, n = saved.plan, len(saved.inputs)
    if saved.lists is None:
        return _gradients_of_empty_picture(saved, grad, requested)
    slots, formats, by_lanes = _composite_adjoint(saved, grad, requested)
    by_gaussians = gaussians_adjoint(
        saved.inputs,
        saved.view,
        saved.lists,
        saved.lists.places(),
        saved.projected.counts,
        slots,
        formats=formats,
        rows=tiles.capacity(n),
        requested=requested,
        plan=plan,
    )
    by_background = _background_gradient(by_lanes, plan)  # last: the host waits for its kernels
    by_camera = (None, None)
    if requested.camera:
        columns = packets.widths(CameraGradient.columns())
        parts = zip(by_gaussians.camera, columns, strict=True)
        sums = [_sum_rows(part, width, n) for part, width in parts]
        by_camera = camera_adjoint(saved.camera, CameraGradient.unpack(np.concatenate(sums)))
    return Gradients(by_gaussians, by_background, *by_camera)


def render_tangent(
    saved: SavedState, dinputs: Inputs, dT: np.ndarray, dK: np.ndarray, dbackground: list[float]
) -> Planes:
    """Draw the picture's tangent.

    Args:
        saved: what :func:`render_forward` returned.
        dinputs: tangents of the Gaussians.
        dT: of ``T_camera_world``, (4, 4).
        dK: of ``K``, (3, 3).
        dbackground: of the background, D.
    """
    plan, F = saved.plan, saved.inputs.float_type
    behind = [dr.opaque(F, b) for b in dbackground]
    if saved.lists is None:
        return Planes.of_background(behind, saved.layout.pixels, plan.options.depth)
    dview = camera_tangent(saved.camera, dT, dK)
    rows = tiles.capacity(len(saved.inputs))
    dsplats = _project_tangent(saved.inputs, saved.view, dinputs, dview, rows=rows, plan=plan)
    return _composite_tangent(saved, dsplats, behind)


def _composite(
    splats: list[packets.Packets],
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    pixels: int,
    plan: Plan,
) -> tuple[Planes, SavedPixels, Array]:
    """Return the picture, its ``SavedPixels``, and where in ``lists.ids`` each lane stopped.

    Args:
        splats: one entry per chunk.
        lists, grid, limit: as ``blend`` takes them.
        background: D arrays of size one.
        pixels: of the picture, padded to whole tiles.
        plan: formats of the chunks, and cut-offs.
    """
    pictures = []
    size = tiles.capacity(pixels)  # few sizes for the boxes of a video: few recordings
    behind, options = chunks.split_background(background, plan.formats), plan.options
    for part, colors, format in zip(splats, behind, plan.formats, strict=True):
        picture, saved_pixels, stop = blend(
            part, lists, grid, colors, limit, pixels=size, format=format, options=options
        )
        pictures.append(picture)
    return chunks.join_planes(pictures, len(background)), saved_pixels, stop


def _composite_adjoint(
    saved: SavedState, grad: Planes, requested: RequestedGradients
) -> tuple[list[packets.Packets], tuple[RecordFormat, ...], list[Array]]:
    """Return the slots of each chunk, their formats, and each lane's gradient of the background.

    Args:
        saved: the forward pass.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        requested: what the slots must hold: the moments are for geometry.
    """
    plan, D = saved.plan, len(saved.background)
    colors = requested.colors or plan.harmonics  # harmonics reach the means too
    slots, slot_formats, by_background = [], [], []
    lists = tiles.composited(saved.lists, saved.stop)
    pictures = chunks.split_gradient(grad, D, len(plan.formats))
    parts = zip(saved.projected.splats, pictures, saved.backgrounds(), plan.formats, strict=True)
    for part, by_picture, behind, format in parts:
        depth = by_picture.depth is not None and requested.geometry
        channels = format.channels if colors else 0
        slot_format = RecordFormat(channels, depth, requested.absolute, requested.geometry)
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


def _composite_tangent(
    saved: SavedState, dsplats: list[packets.Packets], dbackground: list[Array]
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
    for (splats, dpart, colors, dcolors), format in zip(parts, plan.formats, strict=True):
        picture = blend_tangent(
            splats,
            dpart,
            saved.lists,
            saved.stop,
            saved.saved_pixels,
            saved.grid,
            colors,
            dcolors,
            pixels=tiles.capacity(saved.layout.pixels),
            format=format,
            options=plan.options,
        )
        pictures.append(picture)
    return chunks.join_planes(pictures, plan.channels)


def _background_gradient(by_lanes: list[Array], plan: Plan) -> list[float]:
    """Add up the lanes' gradients of the background, (D,), when all kernels have ended."""
    parts = zip(by_lanes, plan.formats, strict=True)
    sums = [_sum_rows(shares, format.channels) for shares, format in parts]
    return np.concatenate(sums)[: plan.channels].tolist()


@Frozen
def project_gaussians(
    inputs: Inputs, view: CameraArrays, grid: Grid, *, rows: int, plan: Plan
) -> ProjectedMemory:
    F, i = inputs.float_type, inputs.index()
    splats = [packets.empty(Splat, format, rows, F) for format in plan.formats]
    footprints = packets.empty(Footprint, None, rows, F)
    found = project(inputs, plan, view)
    parts = chunks.split_splat(found.splat, plan.formats)
    for target, part in zip(splats, parts, strict=True):
        packets.store(target, part, i)
    packets.store(footprints, found.footprint, i)
    counts = tiles.count(found.footprint, grid)
    radii = dr.select(counts > 0, found.radii, 0)
    boxed, depths = tiles.boxed(found.footprint, grid), found.splat.depth
    projected = ProjectedMemory(splats, footprints, depths, counts, radii, boxed, found.finite)
    dr.eval(projected)
    return projected


@Frozen
def gaussians_adjoint(
    inputs: Inputs,
    view: CameraArrays,
    lists: Lists,
    places: Array,
    counts: Array,
    slots: list[packets.Packets],
    *,
    rows: int,
    requested: RequestedGradients,
    plan: Plan,
    formats: tuple[RecordFormat, ...],
) -> GradientMemory:
    target = GradientMemory.empty(inputs, rows, plan.color_width, requested)
    memory = [packets.empty(PairGradient, part, rows, inputs.float_type) for part in formats]
    for part, sums, format in zip(slots, memory, formats, strict=True):
        sum_slots(lists, places, part, format, sums)
    dr.eval(memory)  # two kernels: a single one would run out of registers
    rows_of = zip(memory, formats, strict=True)
    parts = [packets.load(sums, PairGradient, part, inputs.index()) for sums, part in rows_of]
    slot = chunks.add_slots(parts, plan.channels)
    project_adjoint(inputs, plan, view, slot, counts > 0, target)
    dr.eval(target)
    return target


@Frozen
def _project_tangent(
    inputs: Inputs,
    view: CameraArrays,
    dinputs: Inputs,
    dview: CameraArrays,
    *,
    rows: int,
    plan: Plan,
) -> list[packets.Packets]:
    dsplat = project_tangent(inputs, plan, view, dinputs, dview)
    F, i = inputs.float_type, inputs.index()
    dsplats = [packets.empty(Splat, format, rows, F) for format in plan.formats]
    for target, part in zip(dsplats, chunks.split_splat(dsplat, plan.formats), strict=True):
        packets.store(target, part, i)
    dr.eval(dsplats)
    return dsplats


def _gradients_of_empty_picture(
    saved: SavedState, grad: Planes, requested: RequestedGradients
) -> Gradients:
    """Gradients of a picture without Gaussians: all zero but the background's."""
    inputs, D = saved.inputs, saved.plan.channels
    by_u, by_absolute = (dr.zeros(inputs.float_type, 2 * len(inputs)) for _ in range(2))
    by_camera = (np.zeros((4, 4)), np.zeros((3, 3))) if requested.camera else (None, None)
    by_channel = grad.color.numpy().astype(np.float64).reshape(-1, D).sum(axis=0).tolist()
    zeros = inputs.zeros()
    found = GradientMemory(
        means=zeros.means,
        geometry=zeros.geometry,
        opacities=zeros.opacities,
        colors=zeros.colors,
        u=by_u,
        absolute=by_absolute,
        camera=None,
    )
    return Gradients(found, by_channel, *by_camera)


def _sum_rows(flat: Array, width: int, rows: int | None = None) -> np.ndarray:
    """Add up the first ``rows`` rows of a flat array, or all, on the host.

    numpy adds in one thread, in float64: the same bits for any number of threads. Column by
    column, because it takes ten times as long for all at once.
    """
    columns = flat.numpy().reshape(-1, width)[:rows].T
    return np.array([column.sum(dtype=np.float64) for column in columns])
