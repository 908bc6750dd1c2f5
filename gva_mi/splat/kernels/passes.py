"""The kernels one after the other, their adjoints in reverse, and their tangents.

    render_forward:   project  ->  tiles.make_lists  ->  blend
    render_adjoint:   project_adjoint  <-  sum_slots  <-  blend_adjoint
    render_tangent:   project_tangent  ->  blend_tangent

drjit_op.py wraps them for Dr.Jit's autodiff, autograd.py for torch's. Pictures are here *planes*:
flat arrays, padded to whole tiles.

The kernels are frozen (frozen.py): the first call traces and compiles them (0.1-0.5 s each, cached
on disk), later calls replay them whatever the number of Gaussians, the pose or the lens's reach
(near, far, blur). Keyword arguments are constants of a recording: another value is another one. A
pixel's cut-offs and numbers of channels make another kernel too. Sizes of memory that a kernel
allocates for itself (the picture's, the slots') do not: the kernel is the same, and is only traced
again. Memory that comes in as an argument is copied at every call. Up to ``MANY`` Gaussians, their
memory comes in as an argument all the same, because their number changes often; beyond, copying
would cost more than tracing.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels import chunks, packets, tiles
from gva_mi.splat.kernels.blend import Limit, blend_tangent, sum_slots
from gva_mi.splat.kernels.composite import composite, composite_adjoint, sum_rows
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.inputs import GradientMemory, Inputs, Plan, Wanted
from gva_mi.splat.kernels.lens import View, view_adjoint, view_of, view_tangent
from gva_mi.splat.kernels.planes import Planes, Trail
from gva_mi.splat.kernels.project import (
    Projected,
    footprint_memory,
    project,
    project_adjoint,
    project_tangent,
    splat_memory,
)
from gva_mi.splat.kernels.records import Format, ViewGradient
from gva_mi.splat.kernels.tiles import Grid, Layout, Lists
from gva_mi.splat.options import SplatOptions

EVERYTHING = Wanted()  # but the camera and the absolute gradient
MANY = 65_536  # Gaussians from which on the kernels allocate their memory for themselves


@dataclass(frozen=True)
class Saved:
    """A picture, and what its adjoint and tangent need of the forward pass."""

    inputs: Inputs
    plan: Plan
    camera: Camera
    view: View
    background: list[Array]  # D
    layout: Layout
    grid: Grid
    planes: Planes
    projected: Projected | None  # None where there is no Gaussian
    lists: Lists | None  # None where none is drawn
    trail: Trail | None
    stop: Array | None  # where each lane of blend stopped

    def backgrounds(self) -> list[list[Array]]:
        """The background, chunk by chunk."""
        return chunks.split_background(self.background, self.plan.formats)


def render_forward(
    inputs: Inputs,
    harmonics: bool,
    camera: Camera,
    options: SplatOptions,
    background: list[float],
    absolute: bool = False,
    limit: Array | None = None,
    covariances: bool = False,
) -> Saved:
    """The picture, in ``.planes``, padded to whole tiles.

    Args:
        inputs: flat arrays of one precision, of consistent widths.
        harmonics: whether ``inputs.colors`` holds coefficients rather than D channels.
        camera: the view.
        options: cut-offs.
        background: one number per channel.
        absolute: whether the absolute gradient will be asked for: for it the channels are not split
            into chunks.
        limit: m, a plane: a pixel shows only the Gaussians nearer than its number.
        covariances: whether ``inputs.scales`` and ``quats`` hold covariances (covariance.py).

    Raises:
        ValueError: for NaN or infinite inputs, and for more pairs than can be counted.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise ValueError("render(): its kernels are frozen already: do not call it in dr.freeze")
    if not np.isfinite(background).all():
        raise ValueError(f"render(): background must be finite, got {background}")
    F, D = inputs.float_type, len(background)
    layout, view = Layout(camera.width, camera.height), view_of(camera, options)
    grid = layout.grid(dr.int32_array_t(F))
    behind = [dr.opaque(F, b) for b in background]
    formats = chunks.formats(D, options.depth, whole=absolute)
    plan = Plan(options.of_code(), harmonics, inputs.color_width, D, formats, covariances)
    projected = lists = trail = stop = None
    if len(inputs):
        projected = _project_checked(inputs, plan, view, grid)
        lists = tiles.make_lists(
            projected.footprints, projected.depths, projected.counts, layout, grid
        )
    if lists is None:
        planes = Planes.of_background(behind, layout.pixels, options.depth)
    else:
        far = None if limit is None else Limit(limit, projected.depths)
        planes, trail, stop = composite(
            projected.splats, lists, grid, behind, far, layout.pixels, formats, options
        )
    return Saved(
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
        trail=trail,
        stop=stop,
    )


def _project_checked(inputs: Inputs, plan: Plan, view: View, grid: Grid) -> Projected:
    """The Gaussians in the picture, all of whose numbers are finite."""
    n, F = len(inputs), inputs.float_type
    memory, own = None, n
    if n < MANY:
        memory, own = (splat_memory(F, n, plan.formats), footprint_memory(F, n)), 0
    projected = _project(inputs, view, grid, memory, n=own, plan=plan)
    if not dr.all(projected.finite):
        inputs.require_finite(plan.harmonics)
    return projected


@dataclass(frozen=True)
class Gradients:
    """What :func:`render_adjoint` returns; None where it was not asked for."""

    inputs: Inputs
    means2d: Array | None  # 2 N, per px
    background: list[float]  # D
    absolute: Array | None  # 2 N, means2d with every pixel's share taken absolutely
    T_camera_world: np.ndarray | None  # (4, 4)
    K: np.ndarray | None  # (3, 3)


def render_adjoint(saved: Saved, grad: Planes, wanted: Wanted = EVERYTHING) -> Gradients:
    """The reverse of :func:`render_forward`.

    Args:
        saved: what it returned, with ``absolute`` if that is asked for here.
        grad: dL/dplanes, padded to whole tiles with zeros; alpha and depth may be None.
        wanted: the gradients to return; what only others need is not computed.
    """
    plan, n, F = saved.plan, len(saved.inputs), saved.inputs.float_type
    if saved.lists is None:
        return _gradients_of_nothing(saved, grad, wanted)
    slots, formats, by_background = composite_adjoint(
        saved.projected.splats,
        saved.lists,
        saved.grid,
        saved.background,
        saved.trail,
        saved.stop,
        grad,
        plan.formats,
        plan.options,
        wanted.absolute,
        moments=wanted.geometry,
        features=wanted.colors or plan.harmonics,  # harmonics reach the means too
    )
    target = None
    if n < MANY:
        target = GradientMemory.empty(F, n, plan.color_width, wanted)
    target = _gaussians_adjoint(
        saved.inputs,
        saved.view,
        saved.lists,
        slots,
        target,
        n=n if n >= MANY else 0,
        wanted=wanted,
        plan=plan,
        formats=formats,
    )
    by_camera = (None, None)
    if wanted.camera:
        columns = packets.widths(ViewGradient.columns())
        sums = [sum_rows(part, width) for part, width in zip(target.view, columns, strict=True)]
        by_camera = view_adjoint(saved.camera, ViewGradient.unpack(np.concatenate(sums)))
    return Gradients(target.inputs, target.u, by_background, target.absolute, *by_camera)


def render_tangent(
    saved: Saved,
    dinputs: Inputs,
    dT: np.ndarray,
    dK: np.ndarray,
    dbackground: list[float],
) -> Planes:
    """The picture's tangent.

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
    dview = view_tangent(saved.camera, dT, dK)
    memory = splat_memory(F, len(saved.inputs), plan.formats)
    dsplats = _project_tangent(saved.inputs, saved.view, dinputs, dview, memory, plan=plan)
    pictures, dbackgrounds = [], chunks.split_background(behind, plan.formats)
    for k, (colors, format) in enumerate(zip(saved.backgrounds(), plan.formats, strict=True)):
        pictures.append(
            blend_tangent(
                saved.projected.splats[k],
                dsplats[k],
                saved.lists,
                saved.stop,
                saved.trail,
                saved.grid,
                colors,
                dbackgrounds[k],
                Planes.empty(F, format, saved.layout.pixels),
                format=format,
                options=plan.options,
            )
        )
    return chunks.join_planes(pictures, plan.channels)


@Frozen
def _project(
    inputs: Inputs,
    view: View,
    grid: Grid,
    memory: tuple[list[packets.Packets], packets.Packets] | None,
    *,
    n: int,
    plan: Plan,
) -> Projected:
    F, i = inputs.float_type, inputs.lane()
    splats, footprints = memory or (
        splat_memory(F, n, plan.formats, dr.empty),
        footprint_memory(F, n, dr.empty),
    )
    found = project(inputs, plan, view)
    parts = chunks.split_splat(found.splat, plan.formats)
    for target, part in zip(splats, parts, strict=True):
        packets.store(target, part, i)
    packets.store(footprints, found.footprint, i)
    counts = tiles.count(found.footprint, grid)
    radii = dr.select(counts > 0, found.radii, 0)
    boxed, depths = tiles.boxed(found.footprint, grid), found.splat.depth
    projected = Projected(splats, footprints, depths, counts, radii, boxed, found.finite)
    dr.eval(projected)
    return projected


@Frozen
def _gaussians_adjoint(
    inputs: Inputs,
    view: View,
    lists: Lists,
    slots: list[packets.Packets],
    target: GradientMemory | None,
    *,
    n: int,
    wanted: Wanted,
    plan: Plan,
    formats: tuple[Format, ...],
) -> GradientMemory:
    target = target or GradientMemory.empty(
        inputs.float_type, n, plan.color_width, wanted, dr.empty
    )
    sums = [sum_slots(lists, part, format) for part, format in zip(slots, formats, strict=True)]
    dr.eval(sums)  # two kernels: as one they run out of registers
    slot, drawn = chunks.add_slots(sums, plan.channels), lists.counts > 0
    project_adjoint(inputs, plan, view, slot, drawn, target)
    dr.eval(target)
    return target


@Frozen
def _project_tangent(
    inputs: Inputs,
    view: View,
    dinputs: Inputs,
    dview: View,
    dsplats: list[packets.Packets],
    *,
    plan: Plan,
) -> list[packets.Packets]:
    dsplat = project_tangent(inputs, plan, view, dinputs, dview)
    i = inputs.lane()
    for target, part in zip(dsplats, chunks.split_splat(dsplat, plan.formats), strict=True):
        packets.store(target, part, i)
    dr.eval(dsplats)
    return dsplats


def _gradients_of_nothing(saved: Saved, grad: Planes, wanted: Wanted) -> Gradients:
    """Where no Gaussian is drawn, only the background has a gradient."""
    inputs, D = saved.inputs, saved.plan.channels
    by_u = dr.zeros(inputs.float_type, 2 * len(inputs))
    by_camera = (np.zeros((4, 4)), np.zeros((3, 3))) if wanted.camera else (None, None)
    by_channel = grad.color.numpy().astype(np.float64).reshape(-1, D).sum(axis=0).tolist()
    by_absolute = dr.zeros(inputs.float_type, 2 * len(inputs)) if wanted.absolute else None
    return Gradients(inputs.zeros(), by_u, by_channel, by_absolute, *by_camera)
