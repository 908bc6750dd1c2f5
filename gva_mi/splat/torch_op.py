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
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.splat import packets
from gva_mi.splat.blend import Planes
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.pipeline import Saved, render_adjoint, render_forward
from gva_mi.splat.project import GEOMETRY, Inputs

_PRECISION = {torch.float32: Float, torch.float64: Float64}
_DEFAULTS = SplatOptions()


@dataclass
class Screen:
    """The Gaussians as one picture saw them: filled by ``render``, ``grad`` by ``backward``."""

    means2d: Tensor | None = None  # (N, 2) px; of use where visible
    radii: Tensor | None = None  # (N,) px, 3 sigma of the longer axis; 0 where not drawn
    grad: Tensor | None = None  # (N, 2) dL/dmeans2d, per px; 0 where not drawn

    @property
    def visible(self) -> Tensor:
        """Whether each Gaussian touches the picture, (N,) bool."""
        return self.radii > 0


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    screen: Screen | None = None,
) -> Image:
    """The picture of ``gaussians`` from ``camera``.

    Args:
        gaussians: CPU tensors of one dtype, float32 or float64; contiguous ones are not copied.
            Shapes and units: :class:`Gaussians`.
        camera: the view; any size of picture.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), in the precision of the Gaussians.

    Raises:
        ValueError: for wrong shapes, dtypes or devices, NaN or infinite numbers.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated: the
        image is smooth but for steps of ``options.alpha_min`` and ``options.transmittance_min``.
    """
    _check(gaussians, background)
    if background is None:
        background = gaussians.means.new_zeros(gaussians.channels)
    harmonics = gaussians.sh is not None
    tensors = (*gaussians.arrays().values(), background)
    return Image(*_Render.apply(*tensors, harmonics, camera, options, screen))


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
        harmonics: bool,
        camera: Camera,
        options: SplatOptions,
        screen: Screen | None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        F = _PRECISION[means.dtype]
        parts = (means, quats, scales, opacities, colors)
        inputs = Inputs(*(_to_drjit(part, F) for part in parts))
        saved = render_forward(inputs, harmonics, camera, options, background.tolist())
        dr.sync_thread()  # torch reads the memory next
        if screen is not None:
            _fill(screen, saved, means)
        planes = saved.planes
        images = (
            _to_torch(planes.color, saved, saved.channels),
            _to_torch(planes.alpha, saved),
            _to_torch(planes.depth, saved),
        )
        ctx.saved, ctx.screen = saved, screen
        ctx.save_for_backward(*parts, background, *images)
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        # the kernels hold the same memory: this raises where it was overwritten in the meantime
        *tensors, background, _, _, _ = ctx.saved_tensors
        saved: Saved = ctx.saved
        color, alpha, depth = grads
        grad = Planes(
            _padded(color, saved, saved.channels),
            _padded(alpha, saved),
            None if depth is None else _padded(depth, saved),
        )
        inputs, grad_u, by_background = render_adjoint(saved, grad)
        dr.sync_thread()
        if ctx.screen is not None:
            ctx.screen.grad = grad_u.torch().view(-1, 2)
        parts = (inputs.means, inputs.quats, inputs.scales, inputs.opacities, inputs.colors)
        out = [part.torch().view(t.shape) for part, t in zip(parts, tensors, strict=True)]
        return *out, background.new_tensor(by_background), None, None, None, None


def _to_drjit(tensor: Tensor, F: type) -> Array:
    """The tensor's own memory, flat."""
    return F(tensor.detach().contiguous().view(-1))


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
    screen.grad = None
    if saved.projected is None:
        screen.means2d, screen.radii = means.new_zeros(n, 2), means.new_zeros(n)
        return
    first = packets.widths(GEOMETRY + saved.channels + 1)[
        0
    ]  # columns u_0, u_1 lead the first packet
    screen.means2d = saved.projected.rows[0].torch().view(n, first)[:, :2]
    screen.radii = saved.projected.radii.torch()


def _check(gaussians: Gaussians, background: Tensor | None) -> None:
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
