"""``render`` on torch tensors: one autograd.Function around the kernels, without copies.

Torch and Dr.Jit share the memory of the Gaussians, the picture and the gradients. The precision is
that of the tensors: float64 Gaussians run the same kernels in float64. All three images are
differentiable by every tensor of the Gaussians, by the background, and by the camera's matrices
where these are tensors. What densification needs to know of a picture is written to a
:class:`Screen`, where one is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels.inputs import Inputs
from gva_mi.splat.kernels.passes import Saved, render_adjoint, render_forward, render_tangent
from gva_mi.splat.kernels.planes import Planes
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen

ALIGNMENT = 64  # bytes; torch's own memory has it
_PRECISION = {torch.float32: Float, torch.float64: Float64}
_DEFAULTS = SplatOptions()


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    screen: Screen | None = None,
    *,
    means2d: Tensor | None = None,
) -> Image:
    """The picture of ``gaussians`` from ``camera``.

    Args:
        gaussians: CPU tensors of one dtype, float32 or float64; contiguous ones are not copied.
            Shapes and units: :class:`Gaussians`.
        camera: the view; any size of picture. Made from tensors of the same dtype, it is
            differentiable: :meth:`Camera.from_matrices`.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.
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
    _check(gaussians, background, camera, means2d)
    if background is None:
        background = gaussians.means.new_zeros(gaussians.channels)
    tensors = _Tensors(*gaussians.arrays().values(), background, *camera.tensors, means2d)
    view = _View(camera, options, gaussians.sh is not None, screen)
    return Image(*_Render.apply(*tensors, view))


def expected_depth(image: Image) -> Tensor:
    """Depth per alpha, (H, W) m: the mean z of what a pixel shows; 0 where it shows nothing."""
    return image.depth / image.alpha.clamp(min=1e-10)


class _Tensors(NamedTuple):
    """What is differentiated: the tensors of ``_Render``, or their gradients or tangents."""

    means: Any
    quats: Any
    scales: Any
    opacities: Any
    colors: Any  # or coefficients
    background: Any
    T_camera_world: Any
    K: Any
    means2d: Any

    @property
    def gaussians(self) -> tuple[Any, ...]:
        """The five of the Gaussians, in the order of the kernels' ``Inputs``."""
        return self[:5]


@dataclass(frozen=True)
class _View:
    """The rest of a call, which is constant: how the Gaussians are looked at."""

    camera: Camera
    options: SplatOptions
    harmonics: bool  # whether the colours are coefficients
    screen: Screen | None


class _Render(torch.autograd.Function):
    """The three passes of passes.py, as torch's autograd calls them."""

    @staticmethod
    def forward(ctx: FunctionCtx, *arguments: Any) -> tuple[Tensor, Tensor, Tensor]:  # noqa: ANN401
        *tensors, view = arguments
        given, screen = _Tensors(*tensors), view.screen
        F = _PRECISION[given.means.dtype]
        inputs = Inputs(*(_to_drjit(part, F) for part in given.gaussians))
        absolute = screen is not None and screen.absolute
        background = given.background.tolist()
        saved = render_forward(
            inputs, view.harmonics, view.camera, view.options, background, absolute
        )
        dr.sync_thread()  # torch reads the memory next
        if screen is not None:
            screen.fill(saved, given.means)
        images = _images(saved.planes, saved)
        ctx.saved, ctx.screen, ctx.through_means2d = saved, screen, given.means2d is None
        ctx.save_for_backward(*given.gaussians, given.background, *images)
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        # the kernels hold the same memory: this raises where it was overwritten in the meantime
        *parts, background, _, _, _ = ctx.saved_tensors
        saved: Saved = ctx.saved
        screen: Screen | None = ctx.screen
        wanted = _Tensors(*ctx.needs_input_grad[:-1])
        color, alpha, depth = grads
        grad = Planes(
            _padded(color, saved, saved.plan.channels),
            _padded(alpha, saved),
            None if depth is None else _padded(depth, saved),
        )
        found = render_adjoint(
            saved,
            grad,
            camera=wanted.T_camera_world or wanted.K,
            absolute=screen is not None and screen.absolute,
            through_means2d=ctx.through_means2d,
        )
        dr.sync_thread()
        by_means2d = found.means2d.torch().view(-1, 2)
        if screen is not None:
            screen.grad = by_means2d
            if screen.absolute:
                screen.absgrad = found.absolute.torch().view(-1, 2)
        by_gaussians = (
            flat.torch().view(part.shape) for flat, part in zip(found.inputs, parts, strict=True)
        )
        matrix = lambda asked, value: background.new_tensor(value) if asked else None
        out = _Tensors(
            *by_gaussians,
            background=background.new_tensor(found.background),
            T_camera_world=matrix(wanted.T_camera_world, found.T_camera_world),
            K=matrix(wanted.K, found.K),
            means2d=None if ctx.through_means2d else by_means2d,
        )
        return *out, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        saved: Saved = ctx.saved
        F, given = saved.inputs.float_type, _Tensors(*tangents[:-1])
        zero = lambda size: dr.opaque(F, 0, size)
        flat = [
            zero(dr.width(part)) if tangent is None else _to_drjit(tangent, F)
            for part, tangent in zip(saved.inputs, given.gaussians, strict=True)
        ]
        dmeans2d = given.means2d
        if not ctx.through_means2d:
            n = 2 * len(saved.inputs)
            dmeans2d = zero(n) if dmeans2d is None else _to_drjit(dmeans2d, F)
        matrix = lambda tangent, size: (
            np.zeros((size, size)) if tangent is None else tangent.detach().double().numpy()
        )
        behind = given.background
        planes = render_tangent(
            saved,
            Inputs(*flat),
            matrix(given.T_camera_world, 4),
            matrix(given.K, 3),
            [0.0] * saved.plan.channels if behind is None else behind.tolist(),
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
        _to_torch(planes.color, saved, saved.plan.channels),
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


def _check(
    gaussians: Gaussians,
    background: Tensor | None,
    camera: Camera,
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
    shapes = {
        "the camera's T_camera_world": (camera.tensors.T_camera_world, (4, 4)),
        "the camera's K": (camera.tensors.K, (3, 3)),
        "means2d": (means2d, (len(gaussians), 2)),
    }
    for name, (tensor, shape) in shapes.items():
        if tensor is None:
            continue
        if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape:
            found = tuple(tensor.shape) if isinstance(tensor, Tensor) else type(tensor).__name__
            raise ValueError(f"render(): {name} must be a tensor of shape {shape}, got {found}")
        if tensor.dtype != dtype or tensor.device.type != "cpu":
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"render(): {name} must be {dtype} on the CPU, got {found}")
