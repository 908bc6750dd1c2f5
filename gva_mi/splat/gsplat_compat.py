"""gsplat's call, ``rasterization(...)``, on a CPU: change one import, keep the program.

Signature and meaning are those of gsplat 1.5.3. What tells a GPU how to work (``tile_size``, ...)
is accepted and changes no picture; what would change it and is not supported raises.

``meta["means2d"]`` is a node of the graph, as gsplat's users expect it: means2d.py. The other
entries are made when they are read: gsplat_meta.py.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from gva_mi.splat.autograd import PRECISION, not_compiled
from gva_mi.splat.camera import Camera, CameraModel
from gva_mi.splat.covariances import in_the_place_of_quats_and_scales
from gva_mi.splat.gaussians import Gaussians, Image, degree_of
from gva_mi.splat.gsplat_meta import Meta
from gva_mi.splat.gsplat_views import View, Views, joined
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_op import check, expected_depth
from gva_mi.threads import alone_on_the_cores

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
RasterizeMode = Literal["classic", "antialiased"]
AS_CALLED = {  # names of what lies below, and of the arguments here
    r"(the camera's )?\bT_camera_world\b": "viewmats",
    r"(the camera's )?\bK\b(?!,)": "Ks",  # not in a shape
    r"\bfx, fy, cx, cy\b": "the numbers of Ks",
    r"\bfocal lengths\b": "focal lengths of Ks",
    r"\bsize must\b": "width and height must",
    r"\bsh\b": "colors",
    r"\bbackground\b": "backgrounds",
}


@not_compiled
@exclusive
@alone_on_the_cores()
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
    """The pictures of N Gaussians from C cameras.

    Args:
        means: (..., N, 3) m, world; "..." are any number of batch dimensions, of all tensors alike.
        quats: (..., N, 4) wxyz of any length.
        scales: (..., N, 3) m.
        opacities: (..., N) in [0, 1].
        colors: (..., N, D) or (..., C, N, D); with ``sh_degree``, coefficients (..., N, K, 3) or
            (..., C, N, K, 3).
        viewmats: (..., C, 4, 4) world to camera, rigid; differentiable.
        Ks: (..., C, 3, 3) intrinsics, px; differentiable, other than in gsplat.
        width, height: of the pictures, px.
        near_plane, far_plane: m; nearer and farther Gaussians are not drawn.
        radius_clip: px; Gaussians that reach no further are not drawn.
        eps2d: px^2, added to the diagonal of the covariances in the picture.
        sh_degree: which of the coefficients to use; None where ``colors`` are colours.
        packed: whether ``meta`` has rows of those Gaussians alone that are in a picture.
        tile_size: px; of the tiles in ``meta``, no others.
        backgrounds: (..., C, D); black where None.
        render_mode: colours, accumulated depth (D), expected depth (ED), or colours and, as the
            last channel, one of these.
        covars: (..., N, 3, 3) m^2 in the place of quats and scales, which are not looked at then;
            their upper triangles are read, and differentiated by.
        absgrad: whether backward sets ``meta["means2d"].absgrad``, of its shape.
        rasterize_mode: "antialiased" takes from the opacity what the blur adds in area.
        camera_model: of all cameras.
        sparse_grad, channel_chunk, segmented: without effect; gradients are dense.
        distributed, with_ut, with_eval3d, radial_coeffs, tangential_coeffs,
            thin_prism_coeffs, ftheta_coeffs, rolling_shutter, viewmats_rs: not supported.

    Returns:
        Colours (..., C, height, width, D), where D counts the depth; alphas (..., C, height, width,
        1); and ``meta``: "means2d" (..., C, N, 2) px, "depths" (..., C, N) m, "radii" (..., C, N,
        2) int32 px, 0 where not in the picture, "conics" (..., C, N, 3), "opacities" (..., C, N).
        Packed, these have rows (nnz, ...) instead, and "batch_ids", "camera_ids", "gaussian_ids"
        say whose; else these are None. "width", "height", "n_batches", "n_cameras"; and gsplat's
        tiles, by "tile_size": "tile_width", "tile_height", "tiles_per_gauss", "isect_ids",
        "flatten_ids", "isect_offsets".

    Raises:
        ValueError: for wrong shapes and unknown modes, and for what is not supported.

    Note:
        Colours, alphas, means2d and depths are differentiable; the rest of meta is not, but for
        opacities that are not antialiased.
    """
    shutter = getattr(rolling_shutter, "name", rolling_shutter)
    _refuse(
        distributed=distributed,
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
    options = _options(
        blur=eps2d,
        near=near_plane,
        far=far_plane,
        radius_min=radius_clip,
        antialiased=rasterize_mode == "antialiased",
        depth="D" in render_mode,
    )
    by_covars = covars is not None
    shapes = {"covars": covars} if by_covars else {"quats": quats, "scales": scales}
    given = {"means": means, **shapes, "opacities": opacities}
    given |= {"colors": colors, "viewmats": viewmats, "Ks": Ks}
    batch = _check_tensors(given | {"backgrounds": backgrounds}, sh_degree)
    shape = (*batch, viewmats.shape[-3])
    if by_covars:
        rows, columns = torch.triu_indices(3, 3)
        quats, scales = in_the_place_of_quats_and_scales(covars[..., rows, columns])
    of_views = _colors_by_view(colors, shape, sh_degree, render_mode)
    behind = _backgrounds_by_view(backgrounds, shape, of_views, sh_degree, render_mode)
    fitting = _fit(given, sh_degree)
    cameras = zip(_flat(Ks, 2), _flat(viewmats, 2), strict=True)
    bodies = [_flat(x, k) for x, k in ((means, 2), (quats, 2), (scales, 2), (opacities, 1))]
    views = []
    for v, (K, viewmat) in enumerate(cameras):
        body = [part[v // shape[-1]] for part in bodies]
        with _errors_as_called():
            gaussians = Gaussians(*body, **{"colors" if sh_degree is None else "sh": of_views[v]})
            camera = Camera.from_matrices(K, viewmat, width, height, camera_model)
            if not fitting:
                check(gaussians, behind[v], camera)
            views.append(View.of(gaussians, camera, options, behind[v], packed, absgrad, by_covars))
    seen = Views(views, shape, packed)
    pictures = [_channels(image, render_mode) for image in seen.images()]
    if absgrad and seen.means2d.requires_grad:
        seen.attach_absgrad()
    colors_out = joined([color for color, _ in pictures], shape)
    alphas = joined([alpha[..., None] for _, alpha in pictures], shape)
    return colors_out, alphas, seen.meta(opacities, tile_size)


# typed, for True equals 1 and is no number of pixels
_checked_once = functools.lru_cache(typed=True)(SplatOptions)


def _options(**given: Any) -> SplatOptions:  # noqa: ANN401
    """The options, whose ranges are not looked at again where the same numbers are given."""
    plain = all(isinstance(value, int | float) for value in given.values())
    return _checked_once(**given) if plain else SplatOptions(**given)


def _flat(tensor: Tensor, axes: int) -> list[Tensor]:
    """Its elements, each of so many axes; a single one is a view, whose gradient is not copied.

    What has no other axes is taken as it is: a view would be one more node of the graph.
    """
    first = tensor.dim() - axes
    if first == 0:
        return [tensor]
    count, shape = tensor.shape[:first].numel(), tensor.shape[first:]
    return [tensor.reshape(shape)] if count == 1 else list(tensor.reshape(count, *shape))


@contextmanager
def _errors_as_called() -> Iterator[None]:
    """Refusals from below with the names that the arguments have here."""
    try:
        yield
    except ValueError as error:
        message = re.sub(r"^(render\(\)|Gaussians|Camera): ", "rasterization(): ", str(error))
        for here, there in AS_CALLED.items():
            message = re.sub(here, there, message)
        raise ValueError(message) from None


def _refuse(**given: bool) -> None:
    """Name the first argument that was given and is not supported."""
    for name, present in given.items():
        if present:
            raise ValueError(f"rasterization(): {name} is not supported here")


def _require_one_of(name: str, value: str, known: Any) -> None:  # noqa: ANN401 (a Literal)
    if value not in get_args(known):
        found = f"{', '.join(get_args(known))}, got {value!r}"
        raise ValueError(f"rasterization(): {name} must be one of {found}")


def _channels(image: Image, mode: RenderMode) -> tuple[Tensor, Tensor]:
    if mode == "RGB":
        return image.color, image.alpha
    depth = (expected_depth(image) if "ED" in mode else image.depth)[..., None]
    return torch.cat([image.color, depth], dim=-1) if "RGB" in mode else depth, image.alpha


def _check_tensors(given: dict[str, Tensor | None], sh_degree: int | None) -> tuple[int, ...]:
    """Check what the renderer of a single picture does not see; returns the batch's shape."""
    for name, tensor in given.items():
        if not isinstance(tensor, Tensor):
            if tensor is None and name == "backgrounds":
                continue
            found = type(tensor).__name__
            raise ValueError(f"rasterization(): {name} must be a torch tensor, got {found}")
        if not tensor.is_cpu or tensor.dtype not in PRECISION:
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(
                f"rasterization(): {name} must be float32 or float64 on the CPU, got {found}"
            )
    means, viewmats, colors = given["means"], given["viewmats"], given["colors"]
    batch, N = tuple(means.shape[:-2]), means.shape[-2] if means.dim() > 1 else 0
    C = viewmats.shape[-3] if viewmats.dim() > 2 else 0
    if C == 0:
        found = f"must be (..., C, 4, 4) with C > 0, got {tuple(viewmats.shape)}"
        raise ValueError(f"rasterization(): viewmats {found}")
    forms = {"means": (N, 3), "quats": (N, 4), "scales": (N, 3), "opacities": (N,)}
    forms |= {"covars": (N, 3, 3), "viewmats": (C, 4, 4), "Ks": (C, 3, 3)}
    for name, form in forms.items():
        if name in given and tuple(given[name].shape) != batch + form:
            found = f"must be {(*batch, *form)}, got {tuple(given[name].shape)}"
            raise ValueError(f"rasterization(): {name} {found}")
    if "covars" in given and not torch.isfinite(given["covars"]).all():
        raise ValueError("rasterization(): covars must be finite")
    form, axes = ("(N, D)", 2) if sh_degree is None else ("(N, K, 3)", 3)
    shape = tuple(colors.shape)
    if len(shape) < axes or shape[-axes] != N or shape[:-axes] not in (batch, (*batch, C)):
        found = f"{shape} where N is {N} and C {C}"
        raise ValueError(
            f"rasterization(): colors must be (..., {form[1:]} or (..., C, {form[1:]}, got {found}"
        )
    return batch


def _fit(checked: dict[str, Tensor], sh_degree: int | None) -> bool:
    """Whether there is nothing left that ``check`` would refuse: it takes its time to say so."""
    D = checked["colors"].shape[-1]
    channels = D > 0 if sh_degree is None else D == 3
    return channels and len({tensor.dtype for tensor in checked.values()}) == 1


def _backgrounds_by_view(
    backgrounds: Tensor | None,
    shape: tuple[int, ...],
    colors: list[Tensor],
    sh_degree: int | None,
    mode: RenderMode,
) -> list[Tensor | None]:
    """The background of each picture; none where no colours are made."""
    if backgrounds is None or "RGB" not in mode:
        return [None] * len(colors)
    expected = (*shape, colors[0].shape[-1] if sh_degree is None else 3)
    if tuple(backgrounds.shape) != expected:
        found = f"{expected}, got {tuple(backgrounds.shape)}"
        raise ValueError(f"rasterization(): backgrounds must be (..., C, D) = {found}")
    return _flat(backgrounds, 1)


def _colors_by_view(
    colors: Tensor, shape: tuple[int, ...], sh_degree: int | None, mode: RenderMode
) -> list[Tensor]:
    """Colours or coefficients of each picture."""
    axes = 2 if sh_degree is None else 3
    if sh_degree is not None:
        count = (sh_degree + 1) ** 2
        if colors.shape[-2] < count:
            found = f"needs {count} coefficients, got {colors.shape[-2]}"
            raise ValueError(f"rasterization(): sh_degree {sh_degree} {found}")
        with _errors_as_called():
            degree_of(count)
        if colors.shape[-2] > count:
            colors = colors[..., :count, :]
    elif "RGB" not in mode:
        colors = colors[..., :1]  # the kernels want a channel
    parts = _flat(colors, axes)
    of_all_cameras = colors.dim() - axes < len(shape)
    return [part for part in parts for _ in range(shape[-1])] if of_all_cameras else parts
