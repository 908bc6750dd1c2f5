"""``render`` on torch tensors.

The precision is that of the tensors: float64 Gaussians run the same kernels in float64. All three
images are differentiable by every tensor of the Gaussians, by the background, and by the camera's
matrices where these are tensors. A :class:`Screen` receives what densification needs. autograd.py
has the operations for torch's autograd.
"""

from __future__ import annotations

from torch import Tensor

from gva_mi.jit.not_compiled import not_compiled
from gva_mi.jit.tensors import PRECISION
from gva_mi.splat.autograd import Render
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen
from gva_mi.splat.torch_passes import RenderCall, Tensors

_DEFAULTS = SplatOptions()


@not_compiled
def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions = _DEFAULTS,
    background: Tensor | None = None,
    screen: Screen | None = None,
) -> Image:
    """Draw ``gaussians`` as seen from ``camera``.

    Args:
        gaussians: CPU tensors of one dtype, float32 or float64; contiguous ones are not copied.
            Shapes and units: :class:`Gaussians`.
        camera: the view; any size of picture. Made from tensors of the same dtype, it is
            differentiable: :meth:`Camera.from_matrices`.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), in the precision of the Gaussians; no depth
        where ``options.depth`` is off.

    Raises:
        ValueError: a shape, dtype or device is wrong, or a number is NaN or infinite.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated: the
        image is smooth except for steps of ``options.alpha_min`` and ``transmittance_min``.
        Second derivatives raise. ``torch.func``'s transforms work, ``vmap`` one element after the
        other; ``torch.compile`` runs it between graphs, uncompiled.
    """
    check(gaussians, background, camera)
    images = Render.apply(
        *tensors_of(gaussians, background, camera),
        RenderCall(camera, options, gaussians.sh is not None, screen),
    )
    return Image(*images[:-1])


def tensors_of(gaussians: Gaussians, background: Tensor | None, camera: Camera) -> Tensors:
    """Collect everything that is differentiated; black where there is no background."""
    g = gaussians
    if background is None:
        background = g.means.new_zeros(g.channels)
    colors = g.colors if g.sh is None else g.sh
    shape = (g.quats, g.scales, g.covars)
    return Tensors(g.means, *shape, g.opacities, colors, background, *camera.tensors, None, None)


def expected_depth(image: Image) -> Tensor:
    """Depth per alpha, (H, W) m: the mean z of what a pixel shows; 0 where it shows nothing."""
    return image.depth / image.alpha.clamp(min=1e-10)


def check(gaussians: Gaussians, background: Tensor | None, camera: Camera) -> None:
    """Check everything that the kernels rely on.

    Raises:
        ValueError: a kind, dtype, device or shape is wrong.
    """
    dtype = getattr(gaussians.means, "dtype", None)
    for name, tensor in gaussians.arrays().items():
        if problem := problem_of(tensor):
            raise ValueError(f"render(): {name} {problem}")
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


def problem_of(tensor: Tensor) -> str | None:
    """Return what keeps the kernels from reading a tensor, if anything does."""
    if not isinstance(tensor, Tensor):
        return f"must be a torch tensor, got {type(tensor).__name__}"
    if not tensor.is_cpu or tensor.dtype not in PRECISION:
        return f"must be float32 or float64 on the CPU, got {tensor.dtype} on {tensor.device}"
    return None
