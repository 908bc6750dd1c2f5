"""Axes of Gaussians: half a turn between files and the world, and the axes of a covariance.

==========================================  =====================  ==================
Where                                       y                      z
==========================================  =====================  ==================
the world here, SMPL-X, .glb, .spz          up                     toward the viewer
.ply of 3DGS, .splat                        down                   away from it
==========================================  =====================  ==================

x is to the viewer's right in both, so half a turn about x leads from one to the other and back. It
only changes signs: those of y and z, and of the basis functions of colour that are odd in them.

A sheared Gaussian, on cloth that a body stretches, has no orthogonal axes with scales of their own;
it is described by its covariance. Files and viewers need quaternions and scales: the principal axes
of the covariance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt
from gva_mi.splat.gaussians import MAX_DEGREE, Gaussians, degree_of
from gva_mi.splat.kernels.sh import basis

_GENERIC_DIRECTION = (0.3, 0.5, 0.7)  # chosen: no basis function is zero there


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Turn Gaussians (torch tensors) half a turn about x, without rounding; its own inverse.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> one = random_scene(torch.Generator().manual_seed(0), gaussians=1).gaussians
        >>> (half_turned(one).means / one.means).tolist()
        [[1.0, -1.0, -1.0]]
    """
    x, y, z = _GENERIC_DIRECTION
    pairs = zip(basis(MAX_DEGREE, x, y, z), basis(MAX_DEGREE, x, -y, -z), strict=True)
    of_colors = [1.0 if a * b > 0 else -1.0 for a, b in pairs]
    turned = {
        "means": (1.0, -1.0, -1.0),
        "quats": (1.0, 1.0, -1.0, -1.0),
        "covars": (1.0, -1.0, -1.0, 1.0, 1.0, 1.0),
    }
    arrays = gaussians.arrays()
    changed = {k: x * x.new_tensor(turned[k]) for k, x in arrays.items() if k in turned}
    if gaussians.sh is not None:
        sh = gaussians.sh
        changed["sh"] = sh * sh.new_tensor(of_colors[: sh.shape[1]])[:, None]
    return replace(gaussians, **changed)


def rotated(gaussians: Gaussians, R: np.ndarray) -> Gaussians:
    """Rotate Gaussians (torch tensors, with quaternions) by R (3, 3), colours included.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> one = random_scene(torch.Generator().manual_seed(0), gaussians=1).gaussians
        >>> (rotated(one, np.diag([1.0, -1.0, -1.0])).means / one.means).tolist()
        [[1.0, -1.0, -1.0]]
    """
    turn = torch.tensor(R, dtype=torch.float64)
    w, x, y, z = _quaternions(turn[None])[0]
    left = torch.stack([w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w]).view(4, 4)
    found = {"means": gaussians.means.double() @ turn.T, "quats": gaussians.quats.double() @ left.T}
    if gaussians.sh is not None:  # basis(R^T d) = basis(d) M for any directions d
        d = torch.cos(torch.arange(150, dtype=turn.dtype) ** 2).view(50, 3)
        of = lambda d: torch.stack(basis(degree_of(gaussians.sh.shape[1]), *d.T), dim=1)
        M = torch.linalg.lstsq(of(d), of(d @ turn)).solution
        found["sh"] = torch.einsum("kl,nlc->nkc", M, gaussians.sh.double())
    return replace(gaussians, **{k: x.to(gaussians.means) for k, x in found.items()})


UPPER_TRIANGLE = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # index of each entry of a symmetric matrix, by rows


def matrices(covars: Tensor) -> Tensor:
    """Convert covariances (N, 6) to symmetric matrices (N, 3, 3).

    Example:
        >>> matrices(torch.tensor([[1, 2, 3, 4, 5, 6]])).tolist()
        [[[1, 2, 3], [2, 4, 5], [3, 5, 6]]]
    """
    return covars[:, UPPER_TRIANGLE].unflatten(1, (3, 3))


@torch.no_grad()
def with_axes(gaussians: Gaussians) -> Gaussians:
    """Convert covariances of torch tensors to quaternions and scales; not differentiable.

    Example:
        >>> covars, one = torch.tensor([[0.01, 0, 0, 0.04, 0, 0.09]]).double(), torch.ones(1)
        >>> g = Gaussians(torch.zeros(1, 3), None, None, one, one[:, None], covars=covars)
        >>> with_axes(g).scales.round(decimals=6).tolist()
        [[0.1, 0.2, 0.3]]
    """
    if gaussians.covars is None:
        return gaussians
    squares, axes = torch.linalg.eigh(matrices(gaussians.covars).double())
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]  # a mirrored frame is not a rotation
    quats = _quaternions(axes)
    scales = sqrt(squares.clamp_min(0))
    as_given = lambda x: x.to(gaussians.covars)
    return replace(gaussians, quats=as_given(quats), scales=as_given(scales), covars=None)


def _quaternions(R: Tensor) -> Tensor:
    """Convert rotations (N, 3, 3) to quaternions wxyz (N, 4).

    Davenport's matrix 4 q qᵀ - 1 has q as the eigenvector of its largest eigenvalue, whichever
    entry of q is small.
    """
    a, b, c, d, e, f, g, h, i = R.flatten(1).unbind(1)
    rows = [
        [a + e + i, h - f, c - g, d - b],
        [h - f, a - e - i, b + d, c + g],
        [c - g, b + d, e - a - i, f + h],
        [d - b, c + g, f + h, i - a - e],
    ]
    K = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    return torch.linalg.eigh(K).eigenvectors[:, :, -1]
