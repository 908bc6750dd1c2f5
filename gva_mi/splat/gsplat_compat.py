"""gsplat's call, ``rasterization(...)``, on a CPU: change one import, keep the program.

Signature and meaning are those of gsplat 1.5.3. What tells a GPU how to work (``packed``,
``tile_size``, ...) is accepted and has no effect; what would change the picture and is not
supported raises.

``meta["means2d"]`` is a node of the graph, as gsplat's users expect it: its gradient is that of the
loss by the means in the picture, and losses on it reach the means and the cameras. For this the
projection of the means is repeated here in torch, and the kernels hand their gradient by it over
instead of carrying it on themselves (``means2d`` of torch_op.py).
"""

from __future__ import annotations

import weakref
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from gva_mi.splat.autograd import not_compiled
from gva_mi.splat.camera import Camera, CameraModel
from gva_mi.splat.gaussians import Gaussians, Image, degree_of
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.screen import Screen
from gva_mi.splat.torch_op import expected_depth, render

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
RasterizeMode = Literal["classic", "antialiased"]


@not_compiled
def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Tensor | None = None,
    render_mode: RenderMode = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: RasterizeMode = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: CameraModel = "pinhole",
    segmented: bool = False,
    covars: Tensor | None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Tensor | None = None,
    tangential_coeffs: Tensor | None = None,
    thin_prism_coeffs: Tensor | None = None,
    ftheta_coeffs: Any = None,  # noqa: ANN401
    rolling_shutter: Any = None,  # noqa: ANN401
    viewmats_rs: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """The pictures of N Gaussians from C cameras.

    Args:
        means: (N, 3) m, world.
        quats: (N, 4) wxyz of any length.
        scales: (N, 3) m.
        opacities: (N,) in [0, 1].
        colors: (N, D) or (C, N, D); with ``sh_degree``, coefficients (N, K, 3) or (C, N, K, 3).
        viewmats: (C, 4, 4) world to camera, rigid; differentiable.
        Ks: (C, 3, 3) intrinsics, px; differentiable, other than in gsplat.
        width, height: of the pictures, px.
        near_plane, far_plane: m; nearer and farther Gaussians are not drawn.
        radius_clip: px; Gaussians that reach no further are not drawn.
        eps2d: px^2, added to the diagonal of the covariances in the picture.
        sh_degree: which of the coefficients to use; None where ``colors`` are colours.
        backgrounds: (C, D); black where None.
        render_mode: colours, accumulated depth (D), expected depth (ED), or colours and, as the
            last channel, one of these.
        absgrad: whether backward sets ``meta["means2d"].absgrad``, (C, N, 2).
        rasterize_mode: "antialiased" takes from the opacity what the blur adds in area.
        camera_model: of all cameras.
        packed, tile_size, sparse_grad, channel_chunk, segmented: without effect; ``meta`` is never
            packed, and gradients are dense.
        distributed, covars, with_ut, with_eval3d, radial_coeffs, tangential_coeffs,
            thin_prism_coeffs, ftheta_coeffs, rolling_shutter, viewmats_rs: not supported.

    Returns:
        Colours (C, height, width, D), where D counts the depth; alphas (C, height, width, 1); and
        ``meta``: "means2d" (C, N, 2) px, "depths" (C, N) m, "radii" (C, N, 2) int32 px, 0 where not
        in the picture, "conics" (C, N, 3), "opacities" (C, N), "width", "height", "n_cameras".

    Raises:
        ValueError: for wrong shapes and unknown modes, and for what is not supported.

    Note:
        Colours, alphas, means2d and depths are differentiable; conics and, if antialiased,
        meta's opacities are not.
    """
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    _refuse(
        distributed=distributed,
        covars=covars is not None,
        with_ut=with_ut,
        with_eval3d=with_eval3d,
        radial_coeffs=radial_coeffs is not None,
        tangential_coeffs=tangential_coeffs is not None,
        thin_prism_coeffs=thin_prism_coeffs is not None,
        ftheta_coeffs=ftheta_coeffs is not None,
        rolling_shutter=shutter not in (None, "GLOBAL"),
        viewmats_rs=viewmats_rs is not None,
    )
    _require_one_of("render_mode", render_mode, RenderMode)
    _require_one_of("rasterize_mode", rasterize_mode, RasterizeMode)
    _require_one_of("camera_model", camera_model, CameraModel)
    colors = _colors_by_camera(means, colors, viewmats, Ks, sh_degree, render_mode)
    channels = 3 if sh_degree is not None else colors[0].shape[-1]
    behind = _backgrounds_by_camera(backgrounds, len(viewmats), channels, render_mode)
    options = SplatOptions(
        blur=eps2d,
        near=near_plane,
        far=far_plane,
        radius_min=radius_clip,
        antialiased=rasterize_mode == "antialiased",
        depth="D" in render_mode,
    )
    x = _in_cameras(means, viewmats)
    means2d = _in_pictures(x, Ks, camera_model, near_plane)
    kind = "sh" if sh_degree is not None else "colors"
    pictures, screens = [], []
    for c in range(len(viewmats)):
        screen = Screen(absolute=absgrad)
        image = render(
            Gaussians(means, quats, scales, opacities, **{kind: colors[c]}),
            Camera.from_matrices(Ks[c], viewmats[c], width, height, camera_model),
            options,
            behind[c],
            screen,
            means2d=means2d[c],
        )
        pictures.append(_channels(image, render_mode))
        screens.append(screen)
    if absgrad and means2d.requires_grad:
        _attach_absgrad(means2d, screens)
    colors_out = torch.stack([color for color, _ in pictures])
    alphas = torch.stack([alpha[..., None] for _, alpha in pictures])
    drawn = opacities.expand(len(viewmats), len(means))
    if options.antialiased:
        drawn = torch.stack([screen.opacities for screen in screens])
    meta = {"means2d": means2d, "depths": x[..., 2], "opacities": drawn}
    return colors_out, alphas, meta | _meta(screens, width, height)


def _meta(screens: list[Screen], width: int, height: int) -> dict[str, Any]:
    """The entries of ``meta`` that are not differentiable."""
    return {
        "camera_ids": None,
        "gaussian_ids": None,
        "radii": torch.stack([_radii(screen, width, height) for screen in screens]),
        "conics": torch.stack([screen.conics for screen in screens]),
        "width": width,
        "height": height,
        "n_cameras": len(screens),
    }


def _refuse(**given: bool) -> None:
    """Name the first argument that was given and is not supported."""
    for name, present in given.items():
        if present:
            raise ValueError(f"rasterization(): {name} is not supported here")


def _require_one_of(name: str, value: str, known: Any) -> None:  # noqa: ANN401 (a Literal)
    if value not in get_args(known):
        found = f"{', '.join(get_args(known))}, got {value!r}"
        raise ValueError(f"rasterization(): {name} must be one of {found}")


def _backgrounds_by_camera(
    backgrounds: Tensor | None, C: int, channels: int, mode: RenderMode
) -> list[Tensor | None]:
    """The background of each camera; none where no colours are made."""
    if backgrounds is None or "RGB" not in mode:
        return [None] * C
    if tuple(backgrounds.shape) != (C, channels):
        found = f"({C}, {channels}), got {tuple(backgrounds.shape)}"
        raise ValueError(f"rasterization(): backgrounds must be (C, D) = {found}")
    return list(backgrounds)


def _channels(image: Image, mode: RenderMode) -> tuple[Tensor, Tensor]:
    if mode == "RGB":
        return image.color, image.alpha
    depth = (expected_depth(image) if "ED" in mode else image.depth)[..., None]
    return torch.cat([image.color, depth], dim=-1) if "RGB" in mode else depth, image.alpha


def _colors_by_camera(
    means: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    sh_degree: int | None,
    mode: RenderMode,
) -> list[Tensor]:
    """Colours or coefficients of each camera, after a check of what render() does not see."""
    if means.dim() != 2:
        raise ValueError(f"rasterization(): means must be (N, 3), got {tuple(means.shape)}")
    N, C = len(means), len(viewmats)
    if viewmats.shape != (C, 4, 4) or Ks.shape != (C, 3, 3) or C == 0:
        found = f"{tuple(viewmats.shape)} and {tuple(Ks.shape)}"
        raise ValueError(
            f"rasterization(): viewmats must be (C, 4, 4) and Ks (C, 3, 3), got {found}"
        )
    axes = 2 if sh_degree is None else 3
    if colors.dim() not in (axes, axes + 1) or colors.shape[-axes] != N:
        form = "(N, D)" if sh_degree is None else "(N, K, 3)"
        found = f"{tuple(colors.shape)} where N is {N}"
        raise ValueError(f"rasterization(): colors must be {form} or (C, ...), got {found}")
    if colors.dim() > axes and len(colors) != C:
        raise ValueError(f"rasterization(): {len(colors)} colors for {C} cameras")
    if sh_degree is not None:
        count = (sh_degree + 1) ** 2
        if colors.shape[-2] < count:
            found = f"needs {count} coefficients, got {colors.shape[-2]}"
            raise ValueError(f"rasterization(): sh_degree {sh_degree} {found}")
        degree_of(count)
        colors = colors[..., :count, :]
    elif "RGB" not in mode:
        colors = colors[..., :1]  # the kernels want a channel
    return [colors] * C if colors.dim() == axes else list(colors)


def _in_cameras(means: Tensor, viewmats: Tensor) -> Tensor:
    """Means in camera space, (C, N, 3).

    They are written as sums, for the last bits of a matrix product depend on the number of threads.
    """
    R, t = viewmats[:, None, :3, :3], viewmats[:, None, :3, 3]
    return (means[None, :, None, :] * R).sum(dim=-1) + t


def _in_pictures(x: Tensor, Ks: Tensor, model: CameraModel, near: float) -> Tensor:
    """Eq. 2 of lens.py, (C, N, 2); meaningless where a Gaussian is not drawn."""
    f, c = torch.diagonal(Ks, dim1=1, dim2=2)[:, None, :2], Ks[:, None, :2, 2]
    z = torch.where(x[..., 2:] > near, x[..., 2:], 1)
    if model == "pinhole":
        return f * x[..., :2] / z + c
    if model == "ortho":
        return f * x[..., :2] + c
    squared = x[..., :2].square().sum(dim=-1, keepdim=True)
    on_axis = squared < 1e-6 * z * z
    r = torch.where(on_axis, 1, squared).sqrt()
    s = torch.where(on_axis, (1 - squared / (3 * z * z)) / z, torch.atan2(r, z) / r)
    return f * x[..., :2] * s + c


def _radii(screen: Screen, width: int, height: int) -> Tensor:
    """Half the size of each ellipse's box in whole pixels, (N, 2) int32; 0 outside the picture."""
    radii = torch.ceil(screen.extents)
    size = torch.tensor([width, height])
    reaches = (screen.means2d + radii > 0) & (screen.means2d - radii < size)
    return torch.where(reaches.all(dim=1, keepdim=True), radii, 0).to(torch.int32)


def _attach_absgrad(means2d: Tensor, screens: list[Screen]) -> None:
    node = weakref.ref(means2d)  # the tensor holds the hook, so the hook must not hold the tensor

    def attach(grad: Tensor) -> None:
        target = node()
        if target is not None:
            nothing = np.zeros(grad.shape[1:])
            found = [s.absgrad if s.absgrad is not None else nothing for s in screens]
            target.absgrad = torch.stack([torch.as_tensor(g, dtype=grad.dtype) for g in found])

    means2d.register_hook(attach)
