"""The kernels one after the other, their adjoints in reverse, and their tangents.

    render_forward:   project  ->  tiles.make_lists  ->  blend
    render_adjoint:   project_adjoint  <-  sum_slots  <-  blend_adjoint
    render_tangent:   project_tangent  ->  blend_tangent

render.py wraps them for Dr.Jit's autodiff, torch_op.py for torch's. Pictures are here *planes*:
flat arrays, padded to whole tiles.

The kernels are frozen (frozen.py): the first call traces and compiles them (0.1-0.5 s each, cached
on disk), later calls replay them whatever the number of Gaussians or the pose. Keyword arguments
are constants of a recording: another value is another one. Cut-offs and numbers of channels make
another kernel too. Sizes of memory that a kernel allocates for itself (the picture's, the slots')
do not: the kernel is the same, and is only traced again. Memory that comes in as an argument is
copied at every call. That of the Gaussians does so all the same, up to ``MANY`` of them, for their
number changes often; beyond, copying costs more than tracing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels import chunks, packets, tiles
from gva_mi.splat.kernels.blend import Limit, Trail, blend, blend_adjoint, blend_tangent, sum_slots
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.lens import View, view_adjoint, view_of, view_tangent
from gva_mi.splat.kernels.pixels import Planes
from gva_mi.splat.kernels.project import (
    GEOMETRY,
    MOMENTS,
    Inputs,
    Targets,
    project,
    project_adjoint,
    project_tangent,
)
from gva_mi.splat.kernels.tiles import Grid, Layout, Lists
from gva_mi.splat.options import SplatOptions

Allocate = Callable[[type, int], Array]
MANY = 65_536  # Gaussians from which on the kernels allocate their memory for themselves


@dataclass(frozen=True)
class Projected:
    """The Gaussians in the picture."""

    rows: list[packets.Packets]  # GEOMETRY, channels, z: what blend.py reads, chunk by chunk
    footprints: packets.Packets  # what tiles.py reads
    depths: Array  # (N,) m
    counts: Array  # (N,) tiles touched
    radii: Array  # (N,) px, 3 standard deviations along the longer axis; 0 where not drawn
    finite: Array  # (N,)


@dataclass(frozen=True)
class Saved:
    """A picture, and what its adjoint and tangent need of the forward pass."""

    inputs: Inputs
    harmonics: bool  # whether inputs.colors holds coefficients
    channels: int  # D
    chunks: list[int]  # channels composited at a time
    camera: Camera
    view: View
    options: SplatOptions
    background: list[Array]  # D
    layout: Layout
    grid: Grid
    projected: Projected | None  # None where there is no Gaussian
    lists: Lists | None  # None where none is drawn
    trail: Trail | None
    stop: Array  # where each lane of blend stopped
    planes: Planes

    @property
    def width(self) -> int:
        """Columns of ``inputs.colors``."""
        return dr.width(self.inputs.colors) // max(1, dr.width(self.inputs.opacities))


def render_forward(
    inputs: Inputs,
    harmonics: bool,
    camera: Camera,
    options: SplatOptions,
    background: list[float],
    whole: bool = False,
    limit: Array | None = None,
) -> Saved:
    """The picture, in ``.planes``, padded to whole tiles.

    Args:
        inputs: flat arrays of one precision, of consistent widths.
        harmonics: whether ``inputs.colors`` holds coefficients rather than D channels.
        camera: the view.
        options: cut-offs.
        background: one number per channel.
        whole: not to split the channels into chunks; absolute gradients need it.
        limit: m, a plane: a pixel shows only the Gaussians nearer than its number.

    Raises:
        ValueError: for NaN or infinite inputs, and for more pairs than can be counted.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise ValueError("render(): its kernels are frozen already: do not call it in dr.freeze")
    F = type(inputs.means)
    n = dr.width(inputs.opacities)
    D = len(background)
    if not np.isfinite(background).all():
        raise ValueError(f"render(): background must be finite, got {background}")
    layout = Layout(camera.width, camera.height)
    grid = layout.grid(dr.int32_array_t(F))
    view = view_of(camera)
    behind = [dr.opaque(F, b) for b in background]
    parts = chunks.widths(D, whole)

    projected = lists = trail = stop = None
    if n:
        memory = None if n >= MANY else _memory(F, n, parts, options.depth)
        width = dr.width(inputs.colors) // n
        projected = _project(
            inputs,
            view,
            grid,
            memory,
            n=n if n >= MANY else 0,
            width=width,
            harmonics=harmonics,
            options=options,
            parts=tuple(parts),
        )
        if not dr.all(projected.finite):
            _report_not_finite(inputs, harmonics, n)
        lists = tiles.make_lists(
            projected.footprints, projected.depths, projected.counts, layout, grid
        )
    size = layout.padded[0] * layout.padded[1]
    if lists is None:
        planes = _empty_picture(behind, size, options.depth)
    else:
        far = None if limit is None else Limit(limit, projected.depths)
        pictures = []
        by_chunk = chunks.of_background(behind, parts)
        for k, (rows, colors) in enumerate(zip(projected.rows, by_chunk, strict=True)):
            depth = options.depth and k == 0
            picture, trail, stop = blend(
                rows, lists, grid, colors, far, pixels=size, depth=depth, options=options
            )
            pictures.append(picture)
        planes = chunks.join_planes(pictures, D)
    return Saved(
        inputs,
        harmonics,
        D,
        parts,
        camera,
        view,
        options,
        behind,
        layout,
        grid,
        projected,
        lists,
        trail,
        stop,
        planes,
    )


@dataclass(frozen=True)
class Gradients:
    """What :func:`render_adjoint` returns; None where it was not asked for."""

    inputs: Inputs
    means2d: Array  # 2 N, per px
    background: list[float]  # D
    absolute: Array | None  # 2 N, means2d with every pixel's share taken absolutely
    T_camera_world: np.ndarray | None  # (4, 4)
    K: np.ndarray | None  # (3, 3)


def render_adjoint(
    saved: Saved,
    grad: Planes,
    camera: bool = False,
    absolute: bool = False,
    through_means2d: bool = True,
) -> Gradients:
    """The reverse of :func:`render_forward`.

    Args:
        saved: what it returned; ``whole``, if there are more channels than a chunk's and
            ``absolute`` is asked for.
        grad: dL/dplanes, padded to whole tiles with zeros; the depth may be None.
        camera: whether to return the gradients by the camera.
        absolute: whether to return the absolute gradient by the means in the picture.
        through_means2d: whether the gradient by the means in the picture is part of the others.
    """
    F = type(saved.inputs.means)
    n, D = dr.width(saved.inputs.opacities), saved.channels
    i = saved.inputs
    if saved.lists is None:
        parts = (i.means, i.quats, i.scales, i.opacities, i.colors)
        zeros = Inputs(*(dr.zeros(F, dr.width(part)) for part in parts))
        nothing = (np.zeros((4, 4)), np.zeros((3, 3))) if camera else (None, None)
        by_channel = grad.color.numpy().astype(np.float64).reshape(-1, D).sum(axis=0)
        by_absolute = dr.zeros(F, 2 * n) if absolute else None
        return Gradients(zeros, dr.zeros(F, 2 * n), by_channel.tolist(), by_absolute, *nothing)

    slots, by_background = [], []
    pictures = chunks.split_gradient(grad, D, len(saved.chunks))
    backgrounds = chunks.of_background(saved.background, saved.chunks)
    for k, g in enumerate(pictures):
        width, rows, behind = saved.chunks[k], saved.projected.rows[k], backgrounds[k]
        columns = MOMENTS + 2 * absolute + width + (g.depth is not None)
        memory, shares = blend_adjoint(
            rows,
            saved.lists,
            saved.stop,
            saved.grid,
            behind,
            saved.trail,
            g,
            pairs=dr.width(saved.lists.ids),
            lanes=dr.width(saved.lists.tile),
            depth=saved.options.depth and k == 0,
            options=saved.options,
            absolute=absolute,
        )
        slots.append((memory, columns))
        by_background.append((shares, width))

    target = None if n >= MANY else _targets(F, n, saved.width, camera, absolute)
    target = _gaussians_adjoint(
        saved.inputs,
        saved.view,
        saved.lists,
        [memory for memory, _ in slots],
        target,
        n=n if n >= MANY else 0,
        camera=camera,
        absolute=absolute,
        width=saved.width,
        harmonics=saved.harmonics,
        options=saved.options,
        columns=tuple(columns for _, columns in slots),
        channels=D,
        depth=grad.depth is not None,
        through_u=through_means2d,
    )
    sums = [_sum_rows(shares, width) for shares, width in by_background]
    by_camera = (None, None)
    if camera:
        parts = zip(target.view, packets.widths(View.DIFFERENTIABLE), strict=True)
        by_camera = view_adjoint(
            saved.camera, np.concatenate([_sum_rows(part, width) for part, width in parts])
        )
    return Gradients(
        target.inputs, target.u, np.concatenate(sums)[:D].tolist(), target.absolute, *by_camera
    )


def render_tangent(
    saved: Saved,
    dinputs: Inputs,
    dT: np.ndarray,
    dK: np.ndarray,
    dbackground: list[float],
    dmeans2d: Array | None = None,
) -> Planes:
    """The picture's tangent.

    Args:
        saved: what :func:`render_forward` returned.
        dinputs: tangents of the Gaussians.
        dT: of ``T_camera_world``, (4, 4).
        dK: of ``K``, (3, 3).
        dbackground: of the background, D.
        dmeans2d: 2 N; where given, it takes the place of what the above make of the means in the
            picture.
    """
    F = type(saved.inputs.means)
    n, D = dr.width(saved.inputs.opacities), saved.channels
    behind = [dr.opaque(F, b) for b in dbackground]
    size = saved.layout.padded[0] * saved.layout.padded[1]
    if saved.lists is None:
        return _empty_picture(behind, size, saved.options.depth)
    drows = _project_tangent(
        saved.inputs,
        saved.view,
        dinputs,
        view_tangent(saved.camera, dT, dK),
        dmeans2d,
        _memory(F, n, saved.chunks, saved.options.depth)[0],
        width=saved.width,
        harmonics=saved.harmonics,
        options=saved.options,
        parts=tuple(saved.chunks),
    )
    pictures = []
    colors = chunks.of_background(saved.background, saved.chunks)
    dcolors = chunks.of_background(behind, saved.chunks)
    for k, width in enumerate(saved.chunks):
        depth = saved.options.depth and k == 0
        image = [packets.memory(F, size * c) for c in (width, 1, *[1] * depth)]
        pictures.append(
            blend_tangent(
                saved.projected.rows[k],
                drows[k],
                saved.lists,
                saved.stop,
                saved.trail,
                saved.grid,
                colors[k],
                dcolors[k],
                Planes(*image, *[None] * (not depth)),
                depth=depth,
                options=saved.options,
            )
        )
    return chunks.join_planes(pictures, D)


@Frozen
def _project(
    inputs: Inputs,
    view: View,
    grid: Grid,
    memory: tuple[list[packets.Packets], packets.Packets] | None,
    *,
    n: int,
    width: int,
    harmonics: bool,
    options: SplatOptions,
    parts: tuple[int, ...],
) -> Projected:
    F = type(inputs.means)
    rows, footprints = memory or _memory(F, n, parts, options.depth, dr.empty)
    columns, ellipses, radii, finite = project(inputs, width, harmonics, view, options)
    i = dr.arange(dr.uint32_array_t(type(inputs.means)), dr.width(inputs.opacities))
    for target, part in zip(
        rows, chunks.rows_of(columns, GEOMETRY, parts, options.depth), strict=True
    ):
        packets.store(target, part, i)
    tiles.store(ellipses, footprints, i)
    counts = tiles.count(ellipses, grid)
    radii = dr.select(counts > 0, radii, 0)
    depths = columns[-1]
    dr.eval(rows, footprints, counts, radii, depths, finite)
    return Projected(rows, footprints, depths, counts, radii, finite)


@Frozen
def _gaussians_adjoint(
    inputs: Inputs,
    view: View,
    lists: Lists,
    slots: list[packets.Packets],
    target: Targets | None,
    *,
    n: int,
    camera: bool,
    absolute: bool,
    width: int,
    harmonics: bool,
    options: SplatOptions,
    columns: tuple[int, ...],
    channels: int,
    depth: bool,
    through_u: bool,
) -> Targets:
    target = target or _targets(type(inputs.means), n, width, camera, absolute, dr.empty)
    sums = [sum_slots(lists, part, count) for part, count in zip(slots, columns, strict=True)]
    dr.eval(sums)  # two kernels: as one they run out of registers
    shared = MOMENTS + 2 * absolute
    moments = chunks.add_moments(sums, shared, channels, depth)
    drawn = lists.counts > 0
    project_adjoint(inputs, width, harmonics, view, options, moments, drawn, target, through_u)
    dr.eval(target)
    return target


@Frozen
def _project_tangent(
    inputs: Inputs,
    view: View,
    dinputs: Inputs,
    dview: View,
    dmeans2d: Array | None,
    drows: list[packets.Packets],
    *,
    width: int,
    harmonics: bool,
    options: SplatOptions,
    parts: tuple[int, ...],
) -> list[packets.Packets]:
    columns = project_tangent(inputs, width, harmonics, view, options, dinputs, dview)
    i = dr.arange(dr.uint32_array_t(type(inputs.means)), dr.width(inputs.opacities))
    if dmeans2d is not None:
        columns[:2] = packets.load_rows(dmeans2d, 2, i)
    for target, part in zip(
        drows, chunks.rows_of(columns, GEOMETRY, parts, options.depth), strict=True
    ):
        packets.store(target, part, i)
    dr.eval(drows)
    return drows


def _sum_rows(flat: Array, width: int) -> np.ndarray:
    """Sums of the columns of a flat array of rows, on the host.

    numpy adds in one thread, in float64: the same bits for any number of threads.
    """
    return flat.numpy().reshape(-1, width).sum(axis=0, dtype=np.float64)


def _memory(
    F: type, n: int, parts: Sequence[int], depth: bool, allocate: Allocate = packets.memory
) -> tuple[list[packets.Packets], packets.Packets]:
    """Memory for n projected Gaussians: rows, chunk by chunk, and footprints."""
    columns = [GEOMETRY + width + (depth and k == 0) for k, width in enumerate(parts)]
    rows = [packets.empty(F, count, n, allocate) for count in columns]
    return rows, packets.empty(F, tiles.FOOTPRINT, n, allocate)


def _targets(
    F: type,
    n: int,
    width: int,
    camera: bool,
    absolute: bool,
    allocate: Allocate = packets.memory,
) -> Targets:
    """Memory for the gradients of n Gaussians."""
    return Targets(
        Inputs(*(allocate(F, columns * n) for columns in (3, 4, 3, 1, width))),
        allocate(F, 2 * n),
        allocate(F, 2 * n) if absolute else None,
        packets.empty(F, View.DIFFERENTIABLE, n, allocate) if camera else None,
    )


def _empty_picture(background: list[Array], size: int, depth: bool) -> Planes:
    F = type(background[0])
    D = len(background)
    color = packets.memory(F, size * D)
    pixel = dr.arange(dr.uint32_array_t(F), size)
    for c in range(D):
        dr.scatter(color, background[c], pixel * D + c)
    alpha, z = dr.zeros(F, size), dr.zeros(F, size) if depth else None
    dr.eval(color, alpha, z)
    return Planes(color, alpha, z)


def _report_not_finite(inputs: Inputs, harmonics: bool, n: int) -> None:
    for name in ("means", "quats", "scales", "opacities", "colors"):
        array = getattr(inputs, name).numpy()
        bad = np.flatnonzero(~np.isfinite(array))
        if not bad.size:
            continue
        shape = (n, -1) if array.size > n else (n,)
        if name == "colors" and harmonics:
            name, shape = "sh", (n, -1, 3)
        index = np.unravel_index(bad[0], array.reshape(shape).shape)
        where = ", ".join(str(i) for i in index)
        count = f" ({bad.size} such numbers)" if bad.size > 1 else ""
        raise ValueError(f"render(): {name}[{where}] is {array[bad[0]]}, must be finite{count}")
