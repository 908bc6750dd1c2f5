"""Checks of ``rasterization``'s arguments, and their split into one set per picture."""

from __future__ import annotations

from typing import Any, Literal, NoReturn, get_args

import torch
from torch import Tensor

from gva_mi.splat.camera import CameraModel
from gva_mi.splat.gaussians import MAX_DEGREE
from gva_mi.splat.torch_render import problem_of

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
RasterizeMode = Literal["classic", "antialiased"]
NAMES = {  # in Camera, SplatOptions and render; here
    "T_camera_world": "viewmats",
    "near": "near_plane",
    "far": "far_plane",
    "blur": "eps2d",
    "radius_min": "radius_clip",
    "K": "Ks",
    "fx, fy, cx, cy": "the numbers of Ks",
    "focal lengths": "focal lengths of Ks",
    "size": "width and height",
    "sh": "colors",
    "background": "backgrounds",
}


def refuse(problem: str) -> NoReturn:
    """Raise the error of a wrong argument."""
    raise ValueError(f"rasterization(): {problem}")


def require_unused(**given: Any) -> None:  # noqa: ANN401
    """Refuse the first argument that was given and is not supported."""
    for name, value in given.items():
        if value is not None and value is not False:
            refuse(f"{name} is not supported here")


def require_modes(render_mode: str, rasterize_mode: str, camera_model: str) -> None:
    """Check the arguments that are one of a few words."""
    known = {"render_mode": (render_mode, RenderMode)}
    known |= {"rasterize_mode": (rasterize_mode, RasterizeMode)}
    known |= {"camera_model": (camera_model, CameraModel)}
    for name, (value, words) in known.items():
        if value not in get_args(words):
            refuse(f"{name} must be one of {', '.join(get_args(words))}, got {value!r}")


def require_tensors(given: dict[str, Tensor], backgrounds: Tensor | None) -> None:
    """Check kinds, devices and dtypes: all float32 or all float64, on the CPU."""
    optional = {} if backgrounds is None else {"backgrounds": backgrounds}
    for name, tensor in (given | optional).items():
        if problem := problem_of(tensor):
            refuse(f"{name} {problem}")
    dtype = given["means"].dtype
    for name, tensor in given.items():
        if tensor.dtype != dtype:
            refuse(f"{name} must be {dtype}, as means is, got {tensor.dtype}")


def batch_of(given: dict[str, Tensor], sh_degree: int | None) -> tuple[int, ...]:
    """Check that the shapes fit each other, and return the batch dimensions."""
    means, viewmats, colors = given["means"], given["viewmats"], given["colors"]
    batch, N = tuple(means.shape[:-2]), means.shape[-2] if means.dim() > 1 else 0
    C = viewmats.shape[-3] if viewmats.dim() > 2 else 0
    if C == 0:
        refuse(f"viewmats must be (..., C, 4, 4) with C > 0, got {tuple(viewmats.shape)}")
    forms = {"means": (N, 3), "quats": (N, 4), "scales": (N, 3), "opacities": (N,)}
    forms |= {"covars": (N, 3, 3), "viewmats": (C, 4, 4), "Ks": (C, 3, 3)}
    for name, form in forms.items():
        if name in given and tuple(given[name].shape) != batch + form:
            refuse(f"{name} must be {(*batch, *form)}, got {tuple(given[name].shape)}")
    if "covars" in given and not torch.isfinite(given["covars"]).all():
        refuse("covars must be finite")
    form, axes = ("N, D)", 2) if sh_degree is None else ("N, K, 3)", 3)
    shape = tuple(colors.shape)
    fits = len(shape) >= axes and shape[-axes] == N and shape[:-axes] in (batch, (*batch, C))
    if not fits or (shape[-1] < 1 if sh_degree is None else shape[-1] != 3):
        found = f"{shape} where N is {N} and C {C}"
        refuse(f"colors must be (..., {form} or (..., C, {form}, got {found}")
    return batch


def backgrounds_by_view(
    backgrounds: Tensor | None, shape: tuple[int, ...], channels: int, mode: RenderMode
) -> list[Tensor | None]:
    """Split the backgrounds into one per picture; None where no colours are drawn."""
    count = torch.Size(shape).numel()
    if backgrounds is None or "RGB" not in mode:
        return [None] * count
    if tuple(backgrounds.shape) != (*shape, channels):
        found = f"{(*shape, channels)}, got {tuple(backgrounds.shape)}"
        refuse(f"backgrounds must be (..., C, D) = {found}")
    return flat(backgrounds, 1)


def colors_by_view(
    colors: Tensor, shape: tuple[int, ...], sh_degree: int | None, mode: RenderMode
) -> list[Tensor]:
    """Split the colours, or the coefficients up to ``sh_degree``, into one set per picture."""
    axes = 2 if sh_degree is None else 3
    if "RGB" not in mode:
        colors = colors.detach()  # unused: no gradient instead of zeros, as in gsplat
    if sh_degree is not None:
        if sh_degree not in range(MAX_DEGREE + 1):
            refuse(f"sh_degree must be 0 to {MAX_DEGREE}, got {sh_degree}")
        count = (sh_degree + 1) ** 2
        if colors.shape[-2] < count:
            refuse(f"sh_degree {sh_degree} needs {count} coefficients, got {colors.shape[-2]}")
        if colors.shape[-2] > count:
            colors = colors[..., :count, :]
    elif "RGB" not in mode:
        colors = colors[..., :1]  # the kernels need one channel
    parts = flat(colors, axes)
    shared = colors.dim() - axes < len(shape)  # by all cameras
    return [part for part in parts for _ in range(shape[-1])] if shared else parts


def flat(tensor: Tensor, axes: int) -> list[Tensor]:
    """Split a tensor into its elements of so many axes.

    A single element is a view, whose gradient is not copied. A tensor without other axes is
    returned as it is, because a view would be one more node of the graph.
    """
    first = tensor.dim() - axes
    if first == 0:
        return [tensor]
    count, shape = tensor.shape[:first].numel(), tensor.shape[first:]
    return [tensor.reshape(shape)] if count == 1 else list(tensor.reshape(count, *shape))
