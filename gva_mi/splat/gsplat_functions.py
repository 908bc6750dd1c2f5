"""gsplat's small functions on torch tensors, with its names, arguments and meaning.

    spherical_harmonics        c = sum_i b_i(d / |d|) h_i, without the 1/2 and the clamp of eq. 10
    quat_scale_to_covar_preci  Sigma = M S S M^T, and its inverse
    isect_tiles                which tiles each Gaussian's box touches
    isect_offset_encode        where the list of each tile starts
    compute_relocation         Eq. 9 of Kheradmand et al., "3D Gaussian Splatting as Markov Chain
                               Monte Carlo" (2024)

All are torch, and so differentiable by whatever floats they take, but for the tiles.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.splat.gaussians import MAX_DEGREE
from gva_mi.splat.gsplat_meta import Tiles
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


@torch.no_grad()
def isect_tiles(
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    tile_size: int,
    tile_width: int,
    tile_height: int,
    sort: bool = True,
    segmented: bool = False,
    packed: bool = False,
    n_images: int | None = None,
    image_ids: Tensor | None = None,
    gaussian_ids: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Which square tiles of the pictures each Gaussian's box touches.

    Args:
        means2d: (..., N, 2) px, "..." the pictures; packed (nnz, 2).
        radii: (..., N, 2) px, half extents of the box; 0 where not in the picture.
        depths: (..., N) m.
        tile_size: px.
        tile_width, tile_height: how many tiles there are.
        sort: by picture, tile and depth; else pairs lie in the order of the Gaussians.
        segmented: without effect.
        packed: whether the tensors have rows of some Gaussians alone.
        n_images: of packed rows, how many pictures there are.
        image_ids: (nnz,) of packed rows, which picture.
        gaussian_ids: without effect.

    Returns:
        How many tiles each touches, int32 (..., N) or (nnz,); and of each pair (tile, Gaussian)
        picture | tile | depth in the bits of an int64, and int32 the place of the Gaussian in all
        pictures' rows.

    Raises:
        ValueError: for wrong shapes.
    """
    shape = tuple(means2d.shape[:-1])
    if means2d.dim() < (1 if packed else 2) or means2d.shape[-1] != 2:
        raise ValueError(f"isect_tiles(): means2d must be (..., N, 2), got {tuple(means2d.shape)}")
    for name, tensor, form in (("radii", radii, (*shape, 2)), ("depths", depths, shape)):
        if tuple(tensor.shape) != form:
            raise ValueError(f"isect_tiles(): {name} must be {form}, got {tuple(tensor.shape)}")
    if min(tile_size, tile_width, tile_height) < 1:
        found = f"{tile_size}, {tile_width}, {tile_height}"
        raise ValueError(f"isect_tiles(): tile_size, tile_width, tile_height must be >= 1: {found}")
    if packed:
        if n_images is None or image_ids is None or tuple(image_ids.shape) != shape:
            raise ValueError(f"isect_tiles(): packed needs n_images, and image_ids {shape}")
        images = image_ids.long()
    else:
        n_images = math.prod(shape[:-1])
        images = torch.arange(n_images).repeat_interleave(shape[-1])
    picture = (tile_width * tile_size, tile_height * tile_size)
    rows = (means2d.reshape(-1, 2), radii.reshape(-1, 2), depths.reshape(-1))
    found = Tiles.of(*rows, images, n_images, picture, tile_size, sort)
    return found.counts.view(shape), found.keys, found.rows


@torch.no_grad()
def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    """Where the list of each tile starts among sorted pairs, (n_images, tile_height, tile_width).

    Args:
        isect_ids: (n_isects,) int64, sorted, of :func:`isect_tiles`.
        n_images: of pictures.
        tile_width, tile_height: how many tiles each has.
    """
    count = tile_width * tile_height
    place, bits = isect_ids >> 32, count.bit_length()
    tiles = (place >> bits) * count + (place & ((1 << bits) - 1))
    starts = torch.searchsorted(tiles, torch.arange(n_images * count))
    return starts.view(n_images, tile_height, tile_width).int()
