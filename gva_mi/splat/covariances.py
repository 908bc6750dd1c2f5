"""Gaussians whose covariances are given, and their principal axes.

What is sheared, such as cloth that a body stretches, keeps no axes at right angles of which some
scales could tell how long they are by now: it is known by its covariance. Files and viewers know
quaternions and scales alone, and take the covariance's own axes.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from gva_mi.splat.gaussians import Gaussians

MATRIX = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # row by row


def in_the_place_of_quats_and_scales(covars: Tensor) -> tuple[Tensor, Tensor]:
    """Covariances (..., 6) where the kernels look for them, (..., 4) and (..., 3)."""
    xx, xy, xz, yy, yz, zz = covars.unbind(-1)
    unused = torch.zeros_like(xx)
    return torch.stack([unused, xy, xz, yz], -1), torch.stack([xx, yy, zz], -1)


def matrices(covars: Tensor) -> Tensor:
    """Covariances (N, 6) as symmetric matrices (N, 3, 3)."""
    return covars[:, MATRIX].unflatten(1, (3, 3))


@torch.no_grad()
def with_axes(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians, of torch tensors, by quaternions and scales; not differentiable."""
    if gaussians.covars is None:
        return gaussians
    squares, axes = torch.linalg.eigh(matrices(gaussians.covars).double())
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]  # a mirrored frame is no rotation
    quats = _quaternions(axes)
    scales = squares.clamp_min(0).sqrt()
    as_given = lambda x: x.to(gaussians.covars)
    return replace(gaussians, quats=as_given(quats), scales=as_given(scales), covars=None)


def largest_scales(gaussians: Gaussians) -> Tensor:
    """At most so many metres (N,) are the standard deviations along any direction."""
    if gaussians.covars is None:
        return gaussians.scales.amax(1)
    xx, _, _, yy, _, zz = gaussians.covars.unbind(1)
    return (xx + yy + zz).clamp_min(0).sqrt()


def _quaternions(R: Tensor) -> Tensor:
    """Of rotations (N, 3, 3), wxyz (N, 4): Davenport's matrix q qᵀ times 4, less the identity, has
    q for the eigenvector of its largest eigenvalue, whichever entry of q is small."""
    a, b, c, d, e, f, g, h, i = R.flatten(1).unbind(1)
    rows = [
        [a + e + i, h - f, c - g, d - b],
        [h - f, a - e - i, b + d, c + g],
        [c - g, b + d, e - a - i, f + h],
        [d - b, c + g, f + h, i - a - e],
    ]
    K = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    return torch.linalg.eigh(K).eigenvectors[:, :, -1]
