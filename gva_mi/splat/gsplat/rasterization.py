"""gsplat's function ``rasterization(...)`` on a CPU: a drop-in replacement.

Signature and meaning are those of gsplat 1.5.3. Arguments that only tell a GPU how to work
(``tile_size``, ...) are accepted and change no picture. Unsupported arguments that would change it
raise.
"""

from __future__ import annotations

import functools
import re
from typing import Any

import torch
from torch import Tensor

from gva_mi.core.cpu import quiet_openmp
from gva_mi.core.errors import InputError
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.not_compiled import not_compiled
from gva_mi.splat.argument_error import ArgumentError
from gva_mi.splat.camera import Camera, CameraModel
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.gsplat.arguments import (
    NAMES,
    RasterizeMode,
    RenderMode,
    backgrounds_by_view,
    batch_of,
    colors_by_view,
    flat,
    require_modes,
    require_tensors,
    require_unused,
)
from gva_mi.splat.gsplat.views import Meta, RenderedView, RenderedViews, joined
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_render import expected_depth


@not_compiled
@exclusive
@quiet_openmp()
def rasterization(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
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
) -> tuple[Tensor, Tensor, Meta]:
    """Draw N Gaussians as seen from C cameras.

    Args:
        means: (..., N, 3) m, world; "..." are batch dimensions, the same for all tensors.
        quats: (..., N, 4) wxyz of any length.
        scales: (..., N, 3) m.
        opacities: (..., N) in [0, 1].
        colors: (..., N, D) or (..., C, N, D); with ``sh_degree``, coefficients (..., N, K, 3) or
            (..., C, N, K, 3).
        viewmats: (..., C, 4, 4) world to camera, rigid; differentiable.
        Ks: (..., C, 3, 3) intrinsics, px; differentiable, unlike in gsplat.
        width, height: of the pictures, px.
        near_plane, far_plane: m; nearer and farther Gaussians are not drawn.
        radius_clip: px; Gaussians that reach no further are not drawn.
        eps2d: px^2, added to the diagonal of the covariances in the picture.
        sh_degree: highest degree of the coefficients to use; None if ``colors`` are colours.
        packed: whether ``meta`` has rows only for the Gaussians in a picture.
        tile_size: px, returned in ``meta``; the kernels use tiles of their own.
        backgrounds: (..., C, D); black where None.
        render_mode: colours, accumulated depth (D), expected depth (ED), or colours with one of
            these as the last channel.
        covars: (..., N, 3, 3) m^2, used instead of quats and scales; only the upper triangles are
            read and differentiated.
        absgrad: whether backward sets ``meta["means2d"].absgrad``, of its shape.
        rasterize_mode: "antialiased" reduces the opacity by the area that the blur adds.
        camera_model: of all cameras.
        sparse_grad, channel_chunk, segmented: without effect; gradients are dense.
        distributed, with_ut, with_eval3d, radial_coeffs, tangential_coeffs, thin_prism_coeffs,
            ftheta_coeffs, rolling_shutter, viewmats_rs: not supported.

    Returns:
        Colours (..., C, height, width, D), where D counts the depth; alphas (..., C, height, width,
        1); and ``meta``: "means2d" (..., C, N, 2) px, "depths" (..., C, N) m, "radii" (..., C, N,
        2) int32 px, 0 where not in the picture, "conics" (..., C, N, 3), "opacities" (..., C, N).
        Packed, these have rows (nnz, ...) instead, and "batch_ids", "camera_ids", "gaussian_ids"
        say whose; else these are None. "width", "height", "n_batches", "n_cameras", "tile_size",
        "tile_width", "tile_height". gsplat's lists of tiles are not there.

    Raises:
        ValueError: a shape is wrong, a mode is unknown, or an argument is not supported.

    Note:
        Colours, alphas, means2d and depths are differentiable; the rest of meta is not, except
        opacities that are not antialiased.
    """
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    require_unused(
        distributed=distributed,
        with_ut=with_ut,
        with_eval3d=with_eval3d,
        radial_coeffs=radial_coeffs,
        tangential_coeffs=tangential_coeffs,
        thin_prism_coeffs=thin_prism_coeffs,
        ftheta_coeffs=ftheta_coeffs,
        rolling_shutter=None if shutter == "GLOBAL" else shutter,
        viewmats_rs=viewmats_rs,
    )
    require_modes(render_mode, rasterize_mode, camera_model)
    options = _options(
        blur=eps2d,
        near=near_plane,
        far=far_plane,
        radius_min=radius_clip,
        antialiased=rasterize_mode == "antialiased",
        depth="D" in render_mode,
    )
    shape_of = {"quats": quats, "scales": scales} if covars is None else {"covars": covars}
    given = {"means": means, **shape_of, "opacities": opacities}
    given |= {"colors": colors, "viewmats": viewmats, "Ks": Ks}
    require_tensors(given, backgrounds)
    batch = batch_of(given, sh_degree)
    shape = (*batch, viewmats.shape[-3])
    by_view = colors_by_view(colors, shape, sh_degree, render_mode)
    behind = backgrounds_by_view(backgrounds, shape, by_view[0].shape[-1], render_mode)
    bodies = _gaussians(means, quats, scales, covars, opacities)
    kind, views = "colors" if sh_degree is None else "sh", []
    for v, (K, viewmat) in enumerate(zip(flat(Ks, 2), flat(viewmats, 2), strict=True)):
        gaussians = Gaussians(**bodies[v // shape[-1]], **{kind: by_view[v]})
        try:
            camera = Camera.from_matrices(K, viewmat, width, height, camera_model)
            views.append(RenderedView.of(gaussians, camera, options, behind[v], packed, absgrad))
        except ArgumentError as error:
            raise error.renamed("rasterization()", NAMES) from None
    seen = RenderedViews(views, shape, packed)
    pictures = [_channels(image, render_mode) for image in seen.images()]
    if absgrad and seen.means2d.requires_grad:
        seen.attach_absgrad()
    colors_out = joined([color for color, _ in pictures], shape)
    alphas = joined([alpha[..., None] for _, alpha in pictures], shape)
    return colors_out, alphas, seen.meta(opacities, tile_size)


# typed, because True equals 1 and is no number of pixels
_checked_once = functools.lru_cache(typed=True)(SplatOptions)


def _options(**given: Any) -> SplatOptions:  # noqa: ANN401
    """Make the options; numbers that were checked before are not checked again."""
    plain = all(isinstance(value, int | float) for value in given.values())
    try:
        return _checked_once(**given) if plain else SplatOptions(**given)
    except InputError as error:
        problem = str(error).removeprefix("SplatOptions: ")
        renamed = re.sub(r"\w+", lambda word: NAMES.get(word[0], word[0]), problem)
        raise ValueError(f"rasterization(): {renamed}") from None


def _gaussians(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    covars: Tensor | None,
    opacities: Tensor,
) -> list[dict[str, Tensor | None]]:
    """Split the Gaussians, without their colours, into one set per element of the batch."""
    parts = {"means": flat(means, 2), "opacities": flat(opacities, 1)}
    absent = dict.fromkeys(("quats", "scales", "covars"))
    if covars is None:
        parts |= {"quats": flat(quats, 2), "scales": flat(scales, 2)}
    else:
        rows, columns = torch.triu_indices(3, 3)
        parts["covars"] = flat(covars[..., rows, columns], 2)
    count = len(parts["means"])
    return [absent | {name: part[b] for name, part in parts.items()} for b in range(count)]


def _channels(image: Image, mode: RenderMode) -> tuple[Tensor, Tensor]:
    """Return the channels of a render mode, and alpha."""
    if mode == "RGB":
        return image.color, image.alpha
    depth = (expected_depth(image) if "ED" in mode else image.depth)[..., None]
    return torch.cat([image.color, depth], dim=-1) if "RGB" in mode else depth, image.alpha
