"""gsplat's small functions on torch tensors, with its names, arguments and meaning.

    spherical_harmonics        c = sum_i b_i(d / |d|) h_i, without the 1/2 and the clamp of eq. 10
    quat_scale_to_covar_preci  Sigma = M S S M^T, and its inverse
    compute_relocation         Eq. 9 of Kheradmand et al., "3D Gaussian Splatting as Markov Chain
                               Monte Carlo" (2024)

All are torch, and so differentiable by whatever floats they take.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.splat.gaussians import MAX_DEGREE
from gva_mi.splat.kernels import sh
from gva_mi.splat.kernels.ellipse import rotation_entries


def spherical_harmonics(
    degrees_to_use: int, dirs: Tensor, coeffs: Tensor, masks: Tensor | None = None
) -> Tensor:
    """Sums of spherical harmonics, in the order and sign of 3DGS.

    Args:
        degrees_to_use: the highest degree, 0 to 4; further coefficients are not used.
        dirs: (..., 3) of any length; a direction of length zero is (0, 0, 0).
        coeffs: (..., K, 3), K >= (degrees_to_use + 1)^2.
        masks: (...) bool; False gives zeros, without a gradient.

    Returns:
        (..., 3).

    Raises:
        ValueError: for wrong shapes or degrees.
    """
    name, batch = "spherical_harmonics()", tuple(dirs.shape[:-1])
    if degrees_to_use not in range(MAX_DEGREE + 1):
        found = f"must be 0 to {MAX_DEGREE}, got {degrees_to_use}"
        raise ValueError(f"{name}: degrees_to_use {found}")
    count = (degrees_to_use + 1) ** 2
    if dirs.dim() < 1 or dirs.shape[-1] != 3:
        raise ValueError(f"{name}: dirs must be (..., 3), got {tuple(dirs.shape)}")
    if coeffs.dim() != len(batch) + 2 or tuple(coeffs.shape[:-2]) != batch or coeffs.shape[-1] != 3:
        form = f"({', '.join([*map(str, batch), 'K'])}, 3)"
        raise ValueError(f"{name}: coeffs must be {form}, got {tuple(coeffs.shape)}")
    if coeffs.shape[-2] < count:
        found = f"needs {count} coefficients, got {coeffs.shape[-2]}"
        raise ValueError(f"{name}: degrees_to_use {degrees_to_use} {found}")
    if masks is not None and tuple(masks.shape) != batch:
        raise ValueError(f"{name}: masks must be {batch}, got {tuple(masks.shape)}")
    basis = torch.stack(sh.basis(degrees_to_use, *normalize(dirs, dim=-1).unbind(-1)), dim=-1)
    colors = (basis[..., None] * coeffs[..., :count, :]).sum(dim=-2)
    return colors if masks is None else torch.where(masks[..., None], colors, 0)


def quat_scale_to_covar_preci(
    quats: Tensor,
    scales: Tensor,
    compute_covar: bool = True,
    compute_preci: bool = True,
    triu: bool = False,
) -> tuple[Tensor | None, Tensor | None]:
    """Covariances of Gaussians, and their inverses.

    Args:
        quats: (..., 4) wxyz of any length; zero is no rotation.
        scales: (..., 3) m.
        compute_covar, compute_preci: which to make; the other is None.
        triu: whether to return the upper triangles, row by row, (..., 6).

    Returns:
        (..., 3, 3) m^2 and (..., 3, 3) m^-2.

    Raises:
        ValueError: for wrong shapes.
    """
    batch = tuple(quats.shape[:-1])
    if quats.shape[-1:] != (4,) or tuple(scales.shape) != (*batch, 3):
        found = f"(..., 4) and (..., 3), got {tuple(quats.shape)} and {tuple(scales.shape)}"
        raise ValueError(f"quat_scale_to_covar_preci(): quats and scales must be {found}")
    M = torch.stack(rotation_entries(normalize(quats, dim=-1).unbind(-1)), dim=-1)
    M = M.unflatten(-1, (3, 3))

    def spread(sizes: Tensor) -> Tensor:
        A = M * sizes[..., None, :]
        whole = (A[..., :, None, :] * A[..., None, :, :]).sum(dim=-1)
        rows, columns = torch.triu_indices(3, 3)
        return whole[..., rows, columns] if triu else whole

    return spread(scales) if compute_covar else None, spread(1 / scales) if compute_preci else None


def compute_relocation(
    opacities: Tensor, scales: Tensor, ratios: Tensor, binoms: Tensor
) -> tuple[Tensor, Tensor]:
    """Opacities and scales of n copies that, one behind the other, look as one Gaussian did.

        o' = 1 - (1 - o)^(1/n)
        s' = s o / sum_{i=1}^n sum_{k=0}^{i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k + 1)

    In the middle the copies let through what the one did; along a line through the middle they hide
    as much. Summed in float64, for the signs alternate.

    Args:
        opacities: (N,) in [0, 1].
        scales: (N, 3).
        ratios: (N,) n, how many copies there will be; beyond 1 and n_max it is held there. Left as
            it is, other than in gsplat.
        binoms: (n_max, n_max), C(n, k) in row n and column k, 0 where k > n.

    Returns:
        Opacities (N,) and scales (N, 3) of each copy.

    Raises:
        ValueError: for wrong shapes.
    """
    N = tuple(opacities.shape)
    forms = {"scales": (scales, (*N, 3)), "ratios": (ratios, N), "binoms": (binoms, None)}
    for name, (tensor, form) in forms.items():
        square = tensor.dim() == 2 and tensor.shape[0] == tensor.shape[1] > 0
        if not (square if form is None else tuple(tensor.shape) == form):
            found = f"{form or '(n_max, n_max)'}, got {tuple(tensor.shape)}"
            raise ValueError(f"compute_relocation(): {name} must be {found}")
    counts = ratios.long().clamp(1, len(binoms))
    old = opacities.double()
    new = -torch.expm1(torch.log1p(-old) / counts)
    # the sum over i falls on the binomials alone: row n - 1 of their running sums
    totals = binoms.double().cumsum(dim=0)[counts - 1]
    power = torch.arange(1, len(binoms) + 1, dtype=torch.float64)
    signs = 1 - 2 * (torch.arange(len(binoms)) % 2)
    hidden = (totals * signs * new[:, None] ** power / power.sqrt()).sum(dim=1)
    drawn = old > 0
    shrink = torch.where(drawn, old, 1) / torch.where(drawn, hidden, 1)
    return new.to(opacities.dtype), (scales * shrink[:, None]).to(scales.dtype)
