"""``render`` on torch tensors: what it takes, and what it refuses.

The precision is that of the tensors: float64 Gaussians run the same kernels in float64. All three
images are differentiable by every tensor of the Gaussians, by the background, and by the camera's
matrices where these are tensors. What densification needs to know of a picture is written to a
:class:`Screen`, where one is given. How torch's autograd reaches the kernels is autograd.py.
"""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from gva_mi.splat.autograd import PRECISION, Call, Render, Tensors, not_compiled
from gva_mi.splat.camera import Camera
from gva_mi.splat.covariances import in_the_place_of_quats_and_scales
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen

_DEFAULTS = SplatOptions()


@not_compiled
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
        camera: the view; any size of picture. Made from tensors of the same dtype, it is
            differentiable: :meth:`Camera.from_matrices`.
        options: cut-offs.
        background: (D,) colour behind the Gaussians; None is black, as in gsplat.
        screen: filled with means, radii and gradients in the picture, for densification.

    Returns:
        color (H, W, D), alpha (H, W) and depth (H, W), in the precision of the Gaussians; no depth
        where ``options.depth`` is off.

    Raises:
        ValueError: for wrong shapes, dtypes or devices, NaN or infinite numbers.

    Note:
        The order by depth and the set of pixels a Gaussian reaches are not differentiated: the
        image is smooth but for steps of ``options.alpha_min`` and ``options.transmittance_min``.
        Derivatives of derivatives are refused, in a sentence. ``torch.func``'s transforms work,
        ``vmap`` one element after the other; ``torch.compile`` runs it as it is, between graphs.
    """
    check(gaussians, background, camera)
    if background is None:
        background = gaussians.means.new_zeros(gaussians.channels)
    by_covars = gaussians.covars is not None
    if by_covars:
        quats, scales = in_the_place_of_quats_and_scales(gaussians.covars)
        gaussians = replace(gaussians, quats=quats, scales=scales, covars=None)
    tensors = Tensors(*gaussians.arrays().values(), background, *camera.tensors, None, None)
    call = Call(camera, options, gaussians.sh is not None, screen, by_covars)
    return Image(*Render.apply(*tensors, call))


def expected_depth(image: Image) -> Tensor:
    """Depth per alpha, (H, W) m: the mean z of what a pixel shows; 0 where it shows nothing."""
    return image.depth / image.alpha.clamp(min=1e-10)


def check(gaussians: Gaussians, background: Tensor | None, camera: Camera) -> None:
    """Refuse what the kernels cannot take.

    Raises:
        ValueError: for wrong kinds, dtypes, devices or shapes.
    """
    dtype = getattr(gaussians.means, "dtype", None)
    for name, tensor in gaussians.arrays().items():
        if not isinstance(tensor, Tensor):
            found = type(tensor).__name__
            raise ValueError(f"render(): {name} must be a torch tensor, got {found}")
        if not tensor.is_cpu or tensor.dtype not in PRECISION:
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
