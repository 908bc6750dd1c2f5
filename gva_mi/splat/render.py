"""``render``: Gaussians and a camera make a picture; and the two halves of it that autodiff joins.

    render_forward:   project  ->  tiles.make_lists  ->  blend
    render_adjoint:   project_adjoint  <-  sum_slots  <-  blend_adjoint

The kernels are frozen: the first call traces and compiles them (0.1-0.5 s each, cached on disk), later calls replay them
whatever the size of the picture, the number of Gaussians or the pose. Cut-offs and widths are constants in
their code: another value is another kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat import packets, sh, tiles
from gva_mi.splat.blend import Planes, blend, blend_adjoint, sum_slots
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
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

_DEFAULTS = SplatOptions()


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Array = None,
) -> Image:
    """The picture of ``gaussians`` from ``camera``, for Dr.Jit users; differentiable in reverse mode.

    Args:
        gaussians: Dr.Jit tensors of one kind from ``drjit.llvm`` or ``drjit.llvm.ad``: ``TensorXf`` or ``TensorXf64``; see
            :class:`Gaussians` for shapes and units. Their precision is that of the kernels.
        camera: the view; any size of picture.
        options: cut-offs.
        background: (D,) tensor of the same kind, the colour behind the Gaussians; None is black, as in gsplat.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), tensors of the same kind.

    Raises:
        ValueError: for wrong shapes or kinds, NaN or infinite numbers.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated.
    """
    g = gaussians
    harmonics = g.colors is None
    named = {"means": g.means, "quats": g.quats, "scales": g.scales, "opacities": g.opacities}
    named |= {"sh": g.sh} if harmonics else {"colors": g.colors}
    kind = type(g.means)
    for name, tensor in named.items():
        if not dr.is_tensor_v(tensor) or not dr.is_float_v(tensor) or type(tensor) is not kind:
            found = f"means {kind.__name__}, {name} {type(tensor).__name__}"
            raise ValueError(
                f"render(): all inputs must be Dr.Jit float tensors of one kind, got {found}"
            )
    check_shapes({name: tuple(tensor.shape) for name, tensor in named.items()})
    D = 3 if harmonics else g.colors.shape[1]
    if background is None:
        background = dr.zeros(kind, shape=(D,))
    elif type(background) is not kind or tuple(background.shape) != (D,):
        raise ValueError(f"render(): background must be a {kind.__name__} of shape ({D},)")
    return Image(
        *dr.custom(_Render, *named.values(), background, lambda: (harmonics, camera, options))
    )


class _Render(dr.CustomOp):
    """The two halves below, as Dr.Jit's autodiff wants them."""

    NAMES = ("means", "quats", "scales", "opacities", "colors")

    def eval(
        self,
        means: Array,
        quats: Array,
        scales: Array,
        opacities: Array,
        colors: Array,
        background: Array,
        constants: Callable[[], tuple[bool, Camera, SplatOptions]],
    ) -> tuple[Array, Array, Array]:
        harmonics, camera, options = constants()
        parts = (means, quats, scales, opacities, colors)
        self.kind, self.shapes = type(means), [part.shape for part in parts]
        inputs = Inputs(*(dr.detach(part.array, preserve_type=False) for part in parts))
        saved = render_forward(inputs, harmonics, camera, options, background.numpy().tolist())
        self.saved, planes = saved, saved.planes
        return (
            self._image(planes.color, saved.channels),
            self._image(planes.alpha),
            self._image(planes.depth),
        )

    def backward(self) -> None:
        color, alpha, depth = self.grad_out()
        grad = Planes(
            self._plane(color, self.saved.channels), self._plane(alpha), self._plane(depth)
        )
        inputs, _, by_background = render_adjoint(self.saved, grad)
        for name, shape in zip(self.NAMES, self.shapes, strict=True):
            flat = dr.array_t(self.kind)(getattr(inputs, name))
            self.set_grad_in(name, self.kind(flat, shape=shape))
        self.set_grad_in("background", self.kind(by_background))

    def _image(self, plane: Array, channels: int = 0) -> Array:
        """A plane as an image, without its padding; no ``channels`` is an image without that axis."""
        layout = self.saved.layout
        pixels = dr.gather(type(plane), plane, self._inside(channels or 1))
        shape = (layout.height, layout.width) + ((channels,) if channels else ())
        return self.kind(dr.array_t(self.kind)(pixels), shape=shape)

    def _plane(self, image: Array, channels: int = 1) -> Array:
        """An image as a plane, padded with zeros."""
        height, width = self.saved.layout.padded
        F = type(self.saved.inputs.means)
        plane = dr.zeros(F, height * width * channels)
        dr.scatter(plane, dr.detach(image.array, preserve_type=False), self._inside(channels))
        dr.make_opaque(plane)
        return plane

    def _inside(self, channels: int) -> Array:
        """Index in a plane of every number of the picture."""
        layout = self.saved.layout
        row = layout.width * channels
        k = dr.arange(dr.uint32_array_t(type(self.saved.inputs.means)), layout.height * row)
        return k // row * (layout.padded[1] * channels) + k % row


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
        camera: the view. options: cut-offs. background: one number per channel.

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
        rows, footprints = (
            packets.empty(F, GEOMETRY + D + 1, n),
            packets.empty(F, tiles.FOOTPRINT, n),
        )
        projected = _project(
            inputs, dr.width(inputs.colors) // n, harmonics, view, options, grid, rows, footprints
        )
        if not dr.all(projected.finite):
            _report_not_finite(inputs, n)
        lists = tiles.make_lists(footprints, projected.depths, projected.counts, layout, grid)
    size = layout.padded[0] * layout.padded[1]
    if lists is None:
        planes = _empty_picture(behind, size)
    else:
        planes = Planes(dr.empty(F, size * D), dr.empty(F, size), dr.empty(F, size))
        planes, stop = blend(projected.rows, lists, grid, behind, options, planes)
    return Saved(inputs, harmonics, D, view, options, layout, grid, projected, lists, stop, planes)


def render_adjoint(saved: Saved, grad: Planes) -> tuple[Inputs, Array, list[float]]:
    """From dL/dplanes to the gradients of the inputs, of the means in the picture (2 N, px) and of the background.

    Args:
        saved: from :func:`render_forward`.
        grad: padded to whole tiles with zeros; the depth may be None.
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
    shares = dr.empty(F, dr.width(saved.lists.tile) * D)
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
    target = Inputs(*(dr.empty(F, k * n) for k in (3, 4, 3, 1, saved.width)))
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
        dr.empty(F, 2 * n),
    )
    # numpy adds in one thread, in float64: the same bits for any number of threads
    by_lane = shares.numpy().astype(np.float64).reshape(-1, D)[saved.lists.real.numpy()]
    return target, grad_u, by_lane.sum(axis=0).tolist()


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
    drawn = lists.counts > 0
    project_adjoint(inputs, width, harmonics, view, options, moments, drawn, target, grad_u)
    dr.eval(target, grad_u)
    return target, grad_u


def check_shapes(shapes: dict[str, tuple[int, ...]]) -> None:
    """Whether the arrays of Gaussians fit each other.

    Args:
        shapes: of means, quats, scales, opacities, and colors or sh.

    Raises:
        ValueError: naming the first that does not.
    """
    n = shapes["means"][0] if shapes["means"] else 0
    expected = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
    for name, shape in expected.items():
        if shapes[name] != shape:
            form = ", ".join(["N", *map(str, shape[1:])])
            raise ValueError(f"render(): {name} must be ({form}) with N = {n}, got {shapes[name]}")
    if "colors" in shapes:
        shape = shapes["colors"]
        if len(shape) != 2 or shape[0] != n or shape[1] < 1:
            raise ValueError(f"render(): colors must be (N, D) with N = {n}, got {shape}")
        return
    shape = shapes["sh"]
    if len(shape) != 3 or shape[0] != n or shape[2] != 3:
        raise ValueError(f"render(): sh must be (N, K, 3) with N = {n}, got {shape}")
    sh.degree_of(shape[1])


def _empty_picture(background: list[Array], size: int) -> Planes:
    F = type(background[0])
    D = len(background)
    color = dr.empty(F, size * D)
    pixel = dr.arange(dr.uint32_array_t(F), size)
    for c in range(D):
        dr.scatter(color, background[c], pixel * D + c)
    alpha, depth = dr.zeros(F, size), dr.zeros(F, size)
    dr.eval(color, alpha, depth)
    return Planes(color, alpha, depth)


def _report_not_finite(inputs: Inputs, n: int) -> None:
    names = ("means", "quats", "scales", "opacities", "colors or sh")
    parts = (inputs.means, inputs.quats, inputs.scales, inputs.opacities, inputs.colors)
    for name, part in zip(names, parts, strict=True):
        flat = part.numpy()
        bad = np.flatnonzero(~np.isfinite(flat))
        if bad.size:
            row, column = divmod(int(bad[0]), flat.size // n)
            raise ValueError(
                f"render(): {name} must be finite, got {flat[bad[0]]} at Gaussian {row}, entry {column} "
                f"({bad.size} such numbers)"
            )
