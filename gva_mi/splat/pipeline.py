"""The kernels one after the other, and their adjoints in reverse; what autodiff joins.

    render_forward:   project  ->  tiles.make_lists  ->  blend
    render_adjoint:   project_adjoint  <-  sum_slots  <-  blend_adjoint

render.py wraps the two for Dr.Jit's autodiff, torch_op.py for torch's. Pictures are here *planes*:
flat arrays, padded to whole tiles.

The kernels are frozen: the first call traces and compiles them (0.1-0.5 s each, cached on disk),
later calls replay them whatever the size of the picture, the number of Gaussians or the pose. What
a frozen function takes as Python numbers (cut-offs, widths) are constants of its code: another
value is another kernel. So nothing that changes from call to call may be one.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat import packets, tiles
from gva_mi.splat.blend import Planes, blend, blend_adjoint, sum_slots
from gva_mi.splat.camera import Camera
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.project import (
    GEOMETRY,
    MOMENTS,
    Inputs,
    View,
    project,
    project_adjoint,
    view_of,
)
from gva_mi.splat.tiles import Grid, Layout, Lists


@dataclass(frozen=True)
class Projected:
    """The Gaussians in the picture."""

    rows: packets.Packets  # GEOMETRY + D + 1 columns: what blend.py reads
    footprints: packets.Packets  # what tiles.py reads
    depths: Array  # (N,) m
    counts: Array  # (N,) tiles touched
    radii: Array  # (N,) px, 3 standard deviations along the longer axis; 0 where not drawn
    finite: Array  # (N,)


@dataclass(frozen=True)
class Saved:
    """A picture, and what its adjoint needs of the forward pass."""

    inputs: Inputs
    harmonics: bool  # whether inputs.colors holds coefficients
    channels: int  # D
    view: View
    options: SplatOptions
    layout: Layout
    grid: Grid
    projected: Projected | None  # None where there is no Gaussian
    lists: Lists | None  # None where none is drawn
    stop: Array  # where each lane of blend stopped
    planes: Planes

    @property
    def width(self) -> int:
        """Columns of ``inputs.colors``."""
        return dr.width(self.inputs.colors) // max(1, dr.width(self.inputs.opacities))


def render_forward(
    inputs: Inputs, harmonics: bool, camera: Camera, options: SplatOptions, background: list[float]
) -> Saved:
    """The picture, in ``.planes``, padded to whole tiles.

    Args:
        inputs: flat arrays of one precision, of consistent widths.
        harmonics: whether ``inputs.colors`` holds coefficients rather than D channels.
        camera: the view.
        options: cut-offs.
        background: one number per channel.

    Raises:
        ValueError: for NaN or infinite inputs, and for more pairs than can be counted.
    """
    F = type(inputs.means)
    n = dr.width(inputs.opacities)
    D = len(background)
    if not np.isfinite(background).all():
        raise ValueError(f"render(): background must be finite, got {background}")
    layout = Layout(camera.width, camera.height)
    grid = layout.grid(dr.int32_array_t(F))
    view = view_of(camera, F)
    behind = [dr.opaque(F, b) for b in background]

    projected = lists = stop = None
    if n:
        rows = packets.empty(F, GEOMETRY + D + 1, n)
        footprints = packets.empty(F, tiles.FOOTPRINT, n)
        projected = _project(
            inputs, dr.width(inputs.colors) // n, harmonics, view, options, grid, rows, footprints
        )
        if not dr.all(projected.finite):
            _report_not_finite(inputs, harmonics, n)
        lists = tiles.make_lists(footprints, projected.depths, projected.counts, layout, grid)
    size = layout.padded[0] * layout.padded[1]
    if lists is None:
        planes = _empty_picture(behind, size)
    else:
        planes = Planes(*(packets.memory(F, size * k) for k in (D, 1, 1)))
        planes, stop = blend(projected.rows, lists, grid, behind, options, planes)
    return Saved(inputs, harmonics, D, view, options, layout, grid, projected, lists, stop, planes)


def render_adjoint(saved: Saved, grad: Planes) -> tuple[Inputs, Array, list[float]]:
    """The reverse of :func:`render_forward`.

    Args:
        saved: what it returned.
        grad: dL/dplanes, padded to whole tiles with zeros; the depth may be None.

    Returns:
        Gradients of the inputs, of the means in the picture (2 N, per px), and of the background.
    """
    F = type(saved.inputs.means)
    n, D = dr.width(saved.inputs.opacities), saved.channels
    if saved.lists is None:
        i = saved.inputs
        parts = (i.means, i.quats, i.scales, i.opacities, i.colors)
        zeros = Inputs(*(dr.zeros(F, dr.width(part)) for part in parts))
        by_channel = grad.color.numpy().astype(np.float64).reshape(-1, D).sum(axis=0)
        return zeros, dr.zeros(F, 2 * n), by_channel.tolist()

    columns = MOMENTS + D + (grad.depth is not None)
    slots = packets.empty(F, columns, dr.width(saved.lists.ids))
    shares = packets.memory(F, dr.width(saved.lists.tile) * D)
    slots, shares = blend_adjoint(
        saved.projected.rows,
        saved.lists,
        saved.stop,
        saved.grid,
        D,
        saved.options,
        saved.planes,
        grad,
        slots,
        shares,
    )
    target = Inputs(*(packets.memory(F, k * n) for k in (3, 4, 3, 1, saved.width)))
    target, grad_u = _gaussians_adjoint(
        saved.inputs,
        saved.width,
        saved.harmonics,
        saved.view,
        saved.options,
        saved.lists,
        slots,
        columns,
        target,
        packets.memory(F, 2 * n),
    )
    # numpy adds in one thread, in float64: the same bits for any number of threads
    by_lane = shares.numpy().reshape(-1, D)[saved.lists.real.numpy()]
    return target, grad_u, by_lane.astype(np.float64).sum(axis=0).tolist()


@dr.freeze(limit=64, warn_after=1000)
def _project(
    inputs: Inputs,
    width: int,
    harmonics: bool,
    view: View,
    options: SplatOptions,
    grid: Grid,
    rows: packets.Packets,
    footprints: packets.Packets,
) -> Projected:
    columns, ellipses, radii, finite = project(inputs, width, harmonics, view, options)
    i = dr.arange(dr.uint32_array_t(type(inputs.means)), dr.width(inputs.opacities))
    packets.store(rows, columns, i)
    tiles.store(ellipses, footprints, i)
    counts = tiles.count(ellipses, grid)
    radii = dr.select(counts > 0, radii, 0)
    depths = columns[-1]
    dr.eval(rows, footprints, counts, radii, depths, finite)
    return Projected(rows, footprints, depths, counts, radii, finite)


@dr.freeze(limit=64, warn_after=1000)
def _gaussians_adjoint(
    inputs: Inputs,
    width: int,
    harmonics: bool,
    view: View,
    options: SplatOptions,
    lists: Lists,
    slots: packets.Packets,
    columns: int,
    target: Inputs,
    grad_u: Array,
) -> tuple[Inputs, Array]:
    moments = sum_slots(lists, slots, columns)
    dr.eval(moments)  # two kernels: as one they run out of registers
    drawn = lists.counts > 0
    project_adjoint(inputs, width, harmonics, view, options, moments, drawn, target, grad_u)
    dr.eval(target, grad_u)
    return target, grad_u


def _empty_picture(background: list[Array], size: int) -> Planes:
    F = type(background[0])
    D = len(background)
    color = packets.memory(F, size * D)
    pixel = dr.arange(dr.uint32_array_t(F), size)
    for c in range(D):
        dr.scatter(color, background[c], pixel * D + c)
    alpha, depth = dr.zeros(F, size), dr.zeros(F, size)
    dr.eval(color, alpha, depth)
    return Planes(color, alpha, depth)


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
