"""``render`` on torch tensors: one autograd.Function around the kernels, without copies.

Torch and Dr.Jit share the memory of the Gaussians, the picture and the gradients. The precision is
that of the tensors: float64 Gaussians run the same kernels in float64. All three images are
differentiable by every tensor of the Gaussians and by the background.

What densification needs to know of a picture is written to a :class:`Screen`, where one is given:

    screen = Screen()
    image = render(gaussians, camera, screen=screen)
    loss(image).backward()
    moved = screen.grad.norm(dim=1)  # loss per pixel of motion; 0 where not screen.visible
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels.passes import (
    Projected,
    Saved,
    render_adjoint,
    render_forward,
    render_tangent,
)
from gva_mi.splat.kernels.pixels import Planes
from gva_mi.splat.kernels.project import GEOMETRY, Inputs
from gva_mi.splat.kernels.tiles import FOOTPRINT
from gva_mi.splat.options import SplatOptions

ALIGNMENT = 64  # bytes; torch's own memory has it
_PRECISION = {torch.float32: Float, torch.float64: Float64}
_DEFAULTS = SplatOptions()


@dataclass
class Screen:
    """The Gaussians as one picture saw them: filled by ``render``, gradients by ``backward``."""

    means2d: Tensor | None = None  # (N, 2) px; of use where visible
    radii: Tensor | None = None  # (N,) px, 3 sigma of the longer axis; 0 where not drawn
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn
    absolute: bool = False  # set to have absgrad filled as well
    absgrad: Tensor | None = None  # (N, 2) grad with the share of every pixel taken absolutely
    projected: Projected | None = None  # what the kernels know; None where there is no Gaussian

    @property
    def visible(self) -> Tensor:
        """Whether each Gaussian touches the picture, (N,) bool."""
        return self.radii > 0

    @property
    def extents(self) -> Tensor:
        """How far each reaches in x and y, alpha >= alpha_min, (N, 2) px; 0 where culled."""
        if self.projected is None:
            return self.means2d
        ellipse = self.projected.footprints[0].torch().view(-1, FOOTPRINT)
        return torch.where(ellipse[:, 3:4] >= 0, ellipse[:, 2:4], 0)

    @property
    def conics(self) -> Tensor:
        """Inverse covariances in the picture, (N, 3): xx, xy, yy, per px^2."""
        if self.projected is None:
            return self.means2d.new_zeros(0, 3)
        p, q, r = self._geometry[:, 2:5].unbind(1)
        return 2 * math.log(2) * torch.stack([p * p, p * q, q * q + r * r], dim=1)

    @property
    def opacities(self) -> Tensor:
        """Opacities as drawn: less than the Gaussians' own with ``antialiased``, (N,)."""
        if self.projected is None:
            return self.means2d.new_zeros(0)
        return torch.exp2(self._geometry[:, 5])

    @property
    def _geometry(self) -> Tensor:
        packets_ = self.projected.rows[0]
        n = len(self.means2d)
        return torch.cat([part.torch().view(n, -1) for part in packets_], dim=1)[:, :GEOMETRY]


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    screen: Screen | None = None,
    *,
    T_camera_world: Tensor | None = None,
    K: Tensor | None = None,
    means2d: Tensor | None = None,
) -> Image:
    """The picture of ``gaussians`` from ``camera``.

    Args:
        gaussians: CPU tensors of one dtype, float32 or float64; contiguous ones are not copied.
            Shapes and units: :class:`Gaussians`.
        camera: the view; any size of picture.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.
        T_camera_world: (4, 4) rigid; takes the place of the camera's own, and is differentiable.
        K: (3, 3) intrinsics; take the place of the camera's own, and are differentiable.
        means2d: (N, 2) the caller's own projection of the means, where that is to be a node of the
            graph: gradients by the means in the picture go to it alone, and the caller's graph
            takes them on. Its numbers are not read.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), in the precision of the Gaussians; no depth
        where ``options.depth`` is off.

    Raises:
        ValueError: for wrong shapes, dtypes or devices, NaN or infinite numbers.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated: the
        image is smooth but for steps of ``options.alpha_min`` and ``options.transmittance_min``.
        Derivatives of derivatives are not available.
    """
    _check(gaussians, background, T_camera_world, K, means2d)
    if background is None:
        background = gaussians.means.new_zeros(gaussians.channels)
    if T_camera_world is not None or K is not None:
        camera = camera.with_matrices(*(_numpy(matrix) for matrix in (T_camera_world, K)))
    harmonics = gaussians.sh is not None
    tensors = (*gaussians.arrays().values(), background, T_camera_world, K, means2d)
    return Image(*_Render.apply(*tensors, harmonics, camera, options, screen))


def expected_depth(image: Image) -> Tensor:
    """Depth per alpha, (H, W) m: the mean z of what a pixel shows; 0 where it shows nothing."""
    return image.depth / image.alpha.clamp(min=1e-10)


def _numpy(matrix: Tensor | None) -> np.ndarray | None:
    return None if matrix is None else matrix.detach().double().numpy()


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        background: Tensor,
        T_camera_world: Tensor | None,
        K: Tensor | None,
        means2d: Tensor | None,
        harmonics: bool,
        camera: Camera,
        options: SplatOptions,
        screen: Screen | None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        F = _PRECISION[means.dtype]
        parts = (means, quats, scales, opacities, colors)
        inputs = Inputs(*(_to_drjit(part, F) for part in parts))
        whole = screen is not None and screen.absolute
        saved = render_forward(inputs, harmonics, camera, options, background.tolist(), whole)
        dr.sync_thread()  # torch reads the memory next
        if screen is not None:
            _fill(screen, saved, means)
        images = _images(saved.planes, saved)
        ctx.saved, ctx.screen, ctx.through_means2d = saved, screen, means2d is None
        ctx.save_for_backward(*parts, background, *images)
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        # the kernels hold the same memory: this raises where it was overwritten in the meantime
        *tensors, background, _, _, _ = ctx.saved_tensors
        saved: Saved = ctx.saved
        screen: Screen | None = ctx.screen
        color, alpha, depth = grads
        grad = Planes(
            _padded(color, saved, saved.channels),
            _padded(alpha, saved),
            None if depth is None else _padded(depth, saved),
        )
        found = render_adjoint(
            saved,
            grad,
            camera=any(ctx.needs_input_grad[6:8]),
            absolute=screen is not None and screen.absolute,
            through_means2d=ctx.through_means2d,
        )
        dr.sync_thread()
        by_means2d = found.means2d.torch().view(-1, 2)
        if screen is not None:
            screen.grad = by_means2d
            if screen.absolute:
                screen.absgrad = found.absolute.torch().view(-1, 2)
        g = found.inputs
        parts = (g.means, g.quats, g.scales, g.opacities, g.colors)
        out = [part.torch().view(t.shape) for part, t in zip(parts, tensors, strict=True)]
        out.append(background.new_tensor(found.background))
        for wanted, matrix in zip(
            ctx.needs_input_grad[6:8], (found.T_camera_world, found.K), strict=True
        ):
            out.append(background.new_tensor(matrix) if wanted else None)
        out.append(None if ctx.through_means2d else by_means2d)
        return *out, None, None, None, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        saved: Saved = ctx.saved
        i, F = saved.inputs, type(saved.inputs.means)
        parts = (i.means, i.quats, i.scales, i.opacities, i.colors)
        flat = [
            dr.opaque(F, 0, dr.width(part)) if tangent is None else _to_drjit(tangent, F)
            for part, tangent in zip(parts, tangents, strict=False)
        ]
        *_, dbackground, dT, dK, dmeans2d = tangents[:9]
        if not ctx.through_means2d:
            n = 2 * dr.width(i.opacities)
            dmeans2d = dr.opaque(F, 0, n) if dmeans2d is None else _to_drjit(dmeans2d, F)
        planes = render_tangent(
            saved,
            Inputs(*flat),
            np.zeros((4, 4)) if dT is None else _numpy(dT),
            np.zeros((3, 3)) if dK is None else _numpy(dK),
            [0.0] * saved.channels if dbackground is None else dbackground.tolist(),
            dmeans2d,
        )
        dr.sync_thread()
        return _images(planes, saved)


def _to_drjit(tensor: Tensor, F: type) -> Array:
    """The tensor's own memory, flat; a copy where Dr.Jit could not read it in packets."""
    tensor = tensor.detach().contiguous()
    if tensor.data_ptr() % ALIGNMENT:  # from numpy, or a slice
        tensor = tensor.clone()
    return F(tensor.view(-1))


def _images(planes: Planes, saved: Saved) -> tuple[Tensor, Tensor, Tensor]:
    return (
        _to_torch(planes.color, saved, saved.channels),
        _to_torch(planes.alpha, saved),
        None if planes.depth is None else _to_torch(planes.depth, saved),
    )


def _to_torch(plane: Array, saved: Saved, *channels: int) -> Tensor:
    """A plane without its padding; in one piece where the width is a multiple of a tile's."""
    layout = saved.layout
    return plane.torch().view(*layout.padded, *channels)[: layout.height, : layout.width]


def _padded(grad: Tensor | None, saved: Saved, *channels: int) -> Array:
    """The gradient of an image as a plane; zero where there is none."""
    layout, F = saved.layout, type(saved.inputs.means)
    if grad is None:
        return dr.opaque(F, 0, math.prod((*layout.padded, *channels)))
    if grad.shape[:2] != layout.padded:
        whole = grad.new_zeros(*layout.padded, *channels)
        whole[: layout.height, : layout.width] = grad
        grad = whole
    return _to_drjit(grad, F)


def _fill(screen: Screen, saved: Saved, means: Tensor) -> None:
    n = len(means)
    screen.grad = screen.absgrad = None
    screen.projected = saved.projected
    if saved.projected is None:
        screen.means2d, screen.radii = means.new_zeros(n, 2), means.new_zeros(n)
        return
    first = saved.projected.rows[0][0]  # columns u_0, u_1 lead the first packet
    screen.means2d = first.torch().view(n, -1)[:, :2]
    screen.radii = saved.projected.radii.torch()


def _check(
    gaussians: Gaussians,
    background: Tensor | None,
    T_camera_world: Tensor | None,
    K: Tensor | None,
    means2d: Tensor | None,
) -> None:
    dtype = getattr(gaussians.means, "dtype", None)
    for name, tensor in gaussians.arrays().items():
        if not isinstance(tensor, Tensor):
            found = type(tensor).__name__
            raise ValueError(f"render(): {name} must be a torch tensor, got {found}")
        if tensor.device.type != "cpu" or tensor.dtype not in _PRECISION:
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"render(): {name} must be float32 or float64 on the CPU, got {found}")
        if tensor.dtype != dtype:
            found = f"means {dtype}, {name} {tensor.dtype}"
            raise ValueError(f"render(): all tensors must have one dtype, got {found}")
    gaussians.check_shapes()
    D = gaussians.channels
    if background is not None and tuple(background.shape) != (D,):
        raise ValueError(f"render(): background must be ({D},), got {tuple(background.shape)}")
    shapes = {"T_camera_world": (T_camera_world, (4, 4)), "K": (K, (3, 3))}
    shapes["means2d"] = (means2d, (len(gaussians), 2))
    for name, (tensor, shape) in shapes.items():
        if tensor is None:
            continue
        if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape:
            found = tuple(tensor.shape) if isinstance(tensor, Tensor) else type(tensor).__name__
            raise ValueError(f"render(): {name} must be a tensor of shape {shape}, got {found}")
        if tensor.dtype != dtype or tensor.device.type != "cpu":
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"render(): {name} must be {dtype} on the CPU, got {found}")
