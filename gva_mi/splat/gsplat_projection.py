"""gsplat's ``fully_fused_projection``: Gaussians in the picture, and nothing drawn.

Eq. 1 to 5 of the kernels (project.py, lens.py, ellipse.py) in torch, whole and in float64, whatever
the precision of the tensors: what the kernels need for a picture, they do not have to hand out.
``rasterization`` does not come here. It has the same numbers in its ``meta``, faster.
"""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor

from gva_mi.splat.autograd import PRECISION
from gva_mi.splat.camera import CameraModel
from gva_mi.splat.gsplat_functions import quat_scale_to_covar_preci
from gva_mi.splat.kernels.lens import MARGIN
from gva_mi.splat.options import SplatOptions

REACH = 3.33  # standard deviations that a box of gsplat's holds at most
ON_AXIS = 1e-6  # (r / z)^2 up to which a fisheye's s and e are the start of their series


def fully_fused_projection(
    means: Tensor,
    covars: Tensor | None,
    quats: Tensor | None,
    scales: Tensor | None,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    packed: bool = False,
    sparse_grad: bool = False,
    calc_compensations: bool = False,
    camera_model: CameraModel = "pinhole",
    opacities: Tensor | None = None,
) -> tuple[Tensor | None, ...]:
    """N Gaussians in the pictures of C cameras.

    Args:
        means: (..., N, 3) m, world; "..." are any number of batch dimensions, of all tensors alike.
        covars: (..., N, 6) m^2, upper triangles row by row; None where quats and scales are given.
        quats: (..., N, 4) wxyz of any length.
        scales: (..., N, 3) m.
        viewmats: (..., C, 4, 4) world to camera.
        Ks: (..., C, 3, 3) intrinsics, px.
        width, height: of the pictures, px.
        eps2d: px^2, added to the diagonal of the covariances in the picture.
        near_plane, far_plane: m; nearer and farther Gaussians are in no picture.
        radius_clip: px; nor are those that reach no further.
        packed: whether to return rows of those in a picture alone.
        sparse_grad: without effect; gradients are dense.
        calc_compensations: whether to return compensations; else these are None.
        camera_model: of all cameras.
        opacities: (..., N) in [0, 1]: radii reach where alpha falls to 1/255, and not 3.33 sigma.

    Returns:
        radii (..., C, N, 2) int32 px, 0 where not in the picture; there all else is 0 as well.
        means2d (..., C, N, 2) px; depths (..., C, N) m; conics (..., C, N, 3) px^-2: xx, xy, yy of
        the inverse covariance; compensations (..., C, N): sqrt(det C before eps2d / det C after),
        what "antialiased" multiplies opacities by. Packed, these have rows (nnz, ...), and
        batch_ids, camera_ids, gaussian_ids (nnz,) int64 stand before them.

    Raises:
        ValueError: for wrong shapes and kinds, and an unknown camera model.

    Note:
        All but radii and ids are differentiable, by cameras and intrinsics too.
    """
    given = {"means": means, "covars": covars, "quats": quats, "scales": scales}
    given |= {"viewmats": viewmats, "Ks": Ks, "opacities": opacities}
    _check(given, camera_model)
    covars = _covariances(covars, quats, scales)
    T, K = viewmats.double()[..., None, :, :], Ks.double()[..., None, :, :]
    R = T[..., :3, :3]
    x = _product(R, means.double()[..., None, :, :, None])[..., 0] + T[..., :3, 3]  # (..., C, N, 3)
    depths = x[..., 2]
    ahead = (depths > near_plane) & (depths < far_plane)
    x = torch.where(ahead[..., None], x, x.new_tensor([0, 0, 1]))
    size = x.new_tensor([width, height])
    means2d, J = _lens(x, K.diagonal(dim1=-2, dim2=-1)[..., :2], K[..., :2, 2], size, camera_model)
    B = _product(J, R)
    C = _product(_product(B, covars[..., None, :, :, :]), B.transpose(-1, -2))
    xx, xy, yy = C[..., 0, 0], C[..., 0, 1], C[..., 1, 1]
    sharp = xx * yy - xy * xy
    xx, yy = xx + eps2d, yy + eps2d
    det = xx * yy - xy * xy
    ratio = sharp / torch.where(det > 0, det, 1)
    compensations = torch.where(ratio > 0, torch.where(ratio > 0, ratio, 1).sqrt(), 0)
    opacity = None
    if opacities is not None:
        opacity = opacities.double()[..., None, :] * (compensations if calc_compensations else 1)
    with torch.no_grad():
        radii = _boxes(xx, yy, opacity)
        seen = ahead & (det > 0) & (radii > radius_clip).any(dim=-1)
        seen &= ((means2d + radii > 0) & (means2d - radii < size)).all(dim=-1)
        radii = torch.where(seen[..., None], radii, 0).int()
    inverse = torch.stack([yy, -xy, xx], dim=-1) / torch.where(det > 0, det, 1)[..., None]
    found = [means2d, depths, inverse, compensations if calc_compensations else None]
    kept = lambda v: torch.where(seen if v.dim() == seen.dim() else seen[..., None], v, 0)
    whole = [None if v is None else kept(v).to(means.dtype) for v in found]
    if not packed:
        return radii, *whole
    flat = seen.reshape(-1, *seen.shape[-2:])  # batches, cameras, Gaussians
    ids = torch.nonzero(flat).unbind(dim=1)
    return *ids, radii[seen], *(None if v is None else v[seen] for v in whole)


def _covariances(covars: Tensor | None, quats: Tensor | None, scales: Tensor | None) -> Tensor:
    """Sigma (..., N, 3, 3), float64."""
    if covars is None:
        made, _ = quat_scale_to_covar_preci(quats.double(), scales.double(), compute_preci=False)
        return made
    return covars.double()[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].unflatten(-1, (3, 3))


def _product(A: Tensor, B: Tensor) -> Tensor:
    """Of matrices, written as sums: the last bits of ``@`` depend on the number of threads."""
    return (A[..., :, :, None] * B[..., None, :, :]).sum(dim=-2)


def _boxes(xx: Tensor, yy: Tensor, opacity: Tensor | None) -> Tensor:
    """Half extents in whole pixels, (..., 2)."""
    reach = torch.full_like(xx, REACH)
    if opacity is not None:
        tau = 2 * torch.log(opacity / SplatOptions().alpha_min)
        reach = torch.where(tau > 0, torch.minimum(reach, tau.clamp(min=0).sqrt()), 0)
    return torch.ceil(reach[..., None] * torch.stack([xx, yy], dim=-1).clamp(min=0).sqrt())


def _lens(
    x: Tensor, f: Tensor, c: Tensor, size: Tensor, model: CameraModel
) -> tuple[Tensor, Tensor]:
    """Eq. 2-3: where points (..., 3) of camera space fall, (..., 2), and J = du/dx (..., 2, 3)."""
    xy, z = x[..., :2], x[..., 2:]
    f, c = f.expand_as(xy), c.expand_as(xy)
    if model == "ortho":
        return f * xy + c, torch.cat([torch.diag_embed(f), torch.zeros_like(f)[..., None]], dim=-1)
    if model == "pinhole":
        w = f * xy / z
        held = torch.minimum(torch.maximum(w, -MARGIN * size - c), (1 + MARGIN) * size - c)
        return w + c, torch.cat([torch.diag_embed(f / z), (-held / z)[..., None]], dim=-1)
    t = xy.square().sum(dim=-1, keepdim=True)
    h, q = -1 / (t + z * z), t / (z * z)
    on_axis = q < ON_AXIS
    far = torch.where(on_axis, 1, t)
    s = torch.atan2(far.sqrt(), z) / far.sqrt()
    e = (-z * h - s) / far
    s = torch.where(on_axis, (1 - q / 3 + q * q / 5) / z, s)
    e = torch.where(on_axis, (-2 / 3 + q * (4 / 5 - q * 6 / 7)) / z**3, e)
    across = e[..., None] * xy[..., :, None] * xy[..., None, :] + torch.diag_embed(s.expand_as(xy))
    J = f[..., None] * torch.cat([across, (xy * h)[..., None]], dim=-1)
    return f * xy * s + c, J


def _check(given: dict[str, Tensor | None], model: str) -> None:
    """Refuse what does not fit; covars, or quats and scales, or opacities may be None."""
    name = "fully_fused_projection()"
    if model not in get_args(CameraModel):
        known = ", ".join(get_args(CameraModel))
        raise ValueError(f"{name}: camera_model must be one of {known}, got {model!r}")
    if (given["covars"] is None) == (given["quats"] is None and given["scales"] is None) or (
        given["quats"] is None
    ) != (given["scales"] is None):
        raise ValueError(f"{name}: give either covars, or quats and scales")
    for key, tensor in given.items():
        if tensor is not None and (tensor.device.type != "cpu" or tensor.dtype not in PRECISION):
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name}: {key} must be float32 or float64 on the CPU, got {found}")
    means, viewmats = given["means"], given["viewmats"]
    if means.dim() < 2 or viewmats.dim() < 3:
        found = f"{tuple(means.shape)} and {tuple(viewmats.shape)}"
        raise ValueError(
            f"{name}: means must be (..., N, 3) and viewmats (..., C, 4, 4), got {found}"
        )
    batch, N, C = tuple(means.shape[:-2]), means.shape[-2], viewmats.shape[-3]
    forms = {"means": (N, 3), "covars": (N, 6), "quats": (N, 4), "scales": (N, 3)}
    forms |= {"viewmats": (C, 4, 4), "Ks": (C, 3, 3), "opacities": (N,)}
    for key, form in forms.items():
        if given[key] is not None and tuple(given[key].shape) != batch + form:
            found = f"must be {batch + form}, got {tuple(given[key].shape)}"
            raise ValueError(f"{name}: {key} {found}")
