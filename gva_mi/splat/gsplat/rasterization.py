"""gsplat's function ``rasterization(...)`` on a CPU: a drop-in replacement, with checked arguments.

Signature and meaning are those of gsplat 1.5.3. Arguments that only tell a GPU how to work
(``tile_size``, ...) are accepted and change no picture. Unsupported arguments that would change it
raise.
"""

from __future__ import annotations

import functools
import re
from typing import Any, Literal, NoReturn, get_args

import torch
from torch import Tensor

from gva_mi.core.cpu import quiet_openmp
from gva_mi.core.errors import InputError
from gva_mi.jit.frozen import exclusive
from gva_mi.jit.tensors import not_compiled
from gva_mi.splat.camera import ArgumentError, Camera, CameraModel
from gva_mi.splat.gaussians import MAX_DEGREE, Gaussians, Image
from gva_mi.splat.gsplat.views import GsplatView, Meta, RenderedView, RenderedViews, joined
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_passes import Screen
from gva_mi.splat.torch_render import expected_depth, problem_of

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


def _refuse(problem: str) -> NoReturn:
    """Raise the error of a wrong argument."""
    raise ValueError(f"rasterization(): {problem}")


def _require_unused(**given: Any) -> None:  # noqa: ANN401
    """Refuse the first argument that was given and is not supported."""
    for name, value in given.items():
        if value is not None and value is not False:
            _refuse(f"{name} is not supported here")


def _require_modes(render_mode: str, rasterize_mode: str, camera_model: str) -> None:
    """Check the arguments that are one of a few words."""
    known = {"render_mode": (render_mode, RenderMode)}
    known |= {"rasterize_mode": (rasterize_mode, RasterizeMode)}
    known |= {"camera_model": (camera_model, CameraModel)}
    for name, (value, words) in known.items():
        if value not in get_args(words):
            _refuse(f"{name} must be one of {', '.join(get_args(words))}, got {value!r}")


def _require_tensors(given: dict[str, Tensor], backgrounds: Tensor | None) -> None:
    """Check kinds, devices and dtypes: all float32 or all float64, on the CPU."""
    optional = {} if backgrounds is None else {"backgrounds": backgrounds}
    for name, tensor in (given | optional).items():
        if problem := problem_of(tensor):
            _refuse(f"{name} {problem}")
    dtype = given["means"].dtype
    for name, tensor in given.items():
        if tensor.dtype != dtype:
            _refuse(f"{name} must be {dtype}, as means is, got {tensor.dtype}")


def _batch_of(given: dict[str, Tensor], sh_degree: int | None) -> tuple[int, ...]:
    """Check that the shapes fit each other, and return the batch dimensions."""
    means, viewmats, colors = given["means"], given["viewmats"], given["colors"]
    batch, N = tuple(means.shape[:-2]), means.shape[-2] if means.dim() > 1 else 0
    C = viewmats.shape[-3] if viewmats.dim() > 2 else 0
    if C == 0:
        _refuse(f"viewmats must be (..., C, 4, 4) with C > 0, got {tuple(viewmats.shape)}")
    forms = {"means": (N, 3), "quats": (N, 4), "scales": (N, 3), "opacities": (N,)}
    forms |= {"covars": (N, 3, 3), "viewmats": (C, 4, 4), "Ks": (C, 3, 3)}
    for name, form in forms.items():
        if name in given and tuple(given[name].shape) != batch + form:
            _refuse(f"{name} must be {(*batch, *form)}, got {tuple(given[name].shape)}")
    if "covars" in given and not torch.isfinite(given["covars"]).all():
        _refuse("covars must be finite")
    form, axes = ("N, D)", 2) if sh_degree is None else ("N, K, 3)", 3)
    shape = tuple(colors.shape)
    fits = len(shape) >= axes and shape[-axes] == N and shape[:-axes] in (batch, (*batch, C))
    if not fits or (shape[-1] < 1 if sh_degree is None else shape[-1] != 3):
        found = f"{shape} where N is {N} and C {C}"
        _refuse(f"colors must be (..., {form} or (..., C, {form}, got {found}")
    return batch


def _backgrounds_by_view(
    backgrounds: Tensor | None, shape: tuple[int, ...], channels: int, mode: RenderMode
) -> list[Tensor | None]:
    """Split the backgrounds into one per picture; None where no colours are drawn."""
    count = torch.Size(shape).numel()
    if backgrounds is None or "RGB" not in mode:
        return [None] * count
    if tuple(backgrounds.shape) != (*shape, channels):
        found = f"{(*shape, channels)}, got {tuple(backgrounds.shape)}"
        _refuse(f"backgrounds must be (..., C, D) = {found}")
    return _flat(backgrounds, 1)


def _colors_by_view(
    colors: Tensor, shape: tuple[int, ...], sh_degree: int | None, mode: RenderMode
) -> list[Tensor]:
    """Split the colours, or the coefficients up to ``sh_degree``, into one set per picture."""
    axes = 2 if sh_degree is None else 3
    if "RGB" not in mode:
        colors = colors.detach()  # unused: no gradient instead of zeros, as in gsplat
    if sh_degree is not None:
        if sh_degree not in range(MAX_DEGREE + 1):
            _refuse(f"sh_degree must be 0 to {MAX_DEGREE}, got {sh_degree}")
        count = (sh_degree + 1) ** 2
        if colors.shape[-2] < count:
            _refuse(f"sh_degree {sh_degree} needs {count} coefficients, got {colors.shape[-2]}")
        if colors.shape[-2] > count:
            colors = colors[..., :count, :]
    elif "RGB" not in mode:
        colors = colors[..., :1]  # the kernels need one channel
    parts = _flat(colors, axes)
    shared = colors.dim() - axes < len(shape)  # by all cameras
    return [part for part in parts for _ in range(shape[-1])] if shared else parts


def _flat(tensor: Tensor, axes: int) -> list[Tensor]:
    """Split a tensor along all but its last ``axes`` axes.

    A single element is a view, whose gradient is not copied. A tensor without other axes is
    returned as it is, because a view would be one more node of the graph.
    """
    first = tensor.dim() - axes
    if first == 0:
        return [tensor]
    count, shape = tensor.shape[:first].numel(), tensor.shape[first:]
    return [tensor.reshape(shape)] if count == 1 else list(tensor.reshape(count, *shape))


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
    ftheta_coeffs: object = None,
    rolling_shutter: object = None,
    viewmats_rs: Tensor | None = None,
) -> tuple[Tensor, Tensor, Meta]:
    """Draw N Gaussians as seen from C cameras, as gsplat 1.5.3's function of this name does.

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

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=5, width=8, height=6)
        >>> g, camera = scene.gaussians, scene.camera
        >>> viewmats, Ks = torch.tensor(camera.T_camera_world)[None], torch.tensor(camera.K)[None]
        >>> body = (g.means, g.quats, g.scales, g.opacities, g.colors)
        >>> colors, alphas, meta = rasterization(*body, viewmats, Ks, camera.width, camera.height)
        >>> tuple(colors.shape), tuple(alphas.shape), tuple(meta["means2d"].shape)
        ((1, 6, 8, 3), (1, 6, 8, 1), (5, 2))
    """
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    _require_unused(
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
    _require_modes(render_mode, rasterize_mode, camera_model)
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
    _require_tensors(given, backgrounds)
    shape = (*_batch_of(given, sh_degree), viewmats.shape[-3])
    by_view = _colors_by_view(colors, shape, sh_degree, render_mode)
    behind = _backgrounds_by_view(backgrounds, shape, by_view[0].shape[-1], render_mode)
    bodies = _gaussians(means, quats, scales, covars, opacities)
    kind, views = "colors" if sh_degree is None else "sh", []
    for v, (K, viewmat) in enumerate(zip(_flat(Ks, 2), _flat(viewmats, 2), strict=True)):
        gaussians = Gaussians(**bodies[v // shape[-1]], **{kind: by_view[v]})
        try:
            camera = Camera.from_matrices(K, viewmat, width, height, camera_model)
            view = GsplatView(camera, options, kind == "sh", Screen(absolute=absgrad), packed)
            views.append(RenderedView.of(gaussians, behind[v], view))
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
    parts = {"means": _flat(means, 2), "opacities": _flat(opacities, 1)}
    absent = dict.fromkeys(("quats", "scales", "covars"))
    if covars is None:
        parts |= {"quats": _flat(quats, 2), "scales": _flat(scales, 2)}
    else:
        rows, columns = torch.triu_indices(3, 3)
        parts["covars"] = _flat(covars[..., rows, columns], 2)
    count = len(parts["means"])
    return [absent | {name: part[b] for name, part in parts.items()} for b in range(count)]


def _channels(image: Image, mode: RenderMode) -> tuple[Tensor, Tensor]:
    """Return the channels of a render mode, and alpha."""
    if mode == "RGB":
        return image.color, image.alpha
    depth = (expected_depth(image) if "ED" in mode else image.depth)[..., None]
    return torch.cat([image.color, depth], dim=-1) if "RGB" in mode else depth, image.alpha
