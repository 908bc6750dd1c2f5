"""Reference implementation of skinned Gaussians, in plain torch.

It follows the equations of :mod:`gva_mi.avatar.lbs_transforms` and
:mod:`gva_mi.avatar.skin_gaussians`. The fused kernel is checked against it and takes its tangents
from it, and avatars that do not stretch (Eq. 6 of the paper) use its transforms and colours.
"""

from __future__ import annotations

from torch import Tensor

from gva_mi.avatar.lbs_transforms import MAX_STRETCH, SparseWeights
from gva_mi.splat.reference import rotation


def lbs_transforms(weights: SparseWeights, T: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
    """Return A (N, 12) and E (N, 9), row by row, in the precision of the means (N, 3) at rest.

    T (J, 12) float64 are the joints' transforms row by row.

    Example:
        A Gaussian half way between a joint at rest and one that moved by 1 m along y.

        >>> import torch
        >>> weights = SparseWeights.of(torch.full((1, 2), 0.5), slopes=torch.zeros(1, 3, 2))
        >>> T = torch.eye(4, dtype=torch.float64)[:3].repeat(2, 1, 1)
        >>> T[1, 1, 3] = 1
        >>> A, E = lbs_transforms(weights, T.flatten(1), means=torch.zeros(1, 3))
        >>> A.view(3, 4)[:, 3]
        tensor([0.0000, 0.5000, 0.0000])
    """
    N, pairs, T = len(means), weights.gaussians, T.view(-1, 3, 4)[weights.joints]
    W, dW = weights.four[:, 0].double(), weights.four[:, 1:].double()
    x = (T[:, :, :3] * means.double()[pairs, None]).sum(2) + T[:, :, 3]
    A = T.new_zeros(N, 12).index_add(0, pairs, W[:, None] * T.flatten(1))
    E = T.new_zeros(N, 9).index_add(0, pairs, (x[:, :, None] * dW[:, None]).flatten(1))
    return A.to(means), E.to(means)


def _stretched(
    A: Tensor, E: Tensor, means: Tensor, quats: Tensor, scales: Tensor
) -> tuple[Tensor, Tensor]:
    """Return means (N, 3) and covariances (N, 6) of Gaussians that stretch with the skin."""
    A, E = A.view(-1, 3, 4), E.view(-1, 3, 3)
    beta = (1 + E.square().sum((1, 2)) / MAX_STRETCH**2).rsqrt()
    M = rotation(quats)
    F = (A[:, :, :3] + beta[:, None, None] * E) @ M * scales[:, None]
    moved = (A[:, :, :3] @ means[..., None])[..., 0] + A[:, :, 3]
    return moved, (F @ F.mT).flatten(1)[:, [0, 1, 2, 4, 5, 8]]


def lit(sh: Tensor, A: Tensor, light: Tensor) -> Tensor:
    """Return colours (N, 1, 3) of constant colours and slopes (N, 1 or 4, 3) in a light (1, 3).

    Example:
        A grey that is brighter by 0.1 for a light along +x.

        >>> import torch
        >>> sh, A = torch.zeros(1, 4, 3), torch.eye(4)[:3].reshape(1, 12)
        >>> sh[0, 0], sh[0, 1] = 0.5, 0.1
        >>> lit(sh, A, torch.tensor([[1.0, 0, 0]])), lit(sh, A, torch.tensor([[0, 1.0, 0]]))
        (tensor([[[0.6000, 0.6000, 0.6000]]]), tensor([[[0.5000, 0.5000, 0.5000]]]))
    """
    t = (A.view(-1, 3, 4)[:, :, :3] * light[..., None]).sum(1)
    return sh[:, :1] + (t[:, : sh.shape[1] - 1, None] * sh[:, 1:]).sum(1, keepdim=True)


def skinned(
    weights: SparseWeights,
    T: Tensor,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    sh: Tensor,
    light: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return means (N, 3), covariances (N, 6) and colours (N, 3); ``sh`` is (N, 12).

    Example:
        A ball half way between a joint at rest and one that moved by 1 m along y stays a ball.

        >>> import torch
        >>> weights = SparseWeights.of(torch.full((1, 2), 0.5), slopes=torch.zeros(1, 3, 2))
        >>> T = torch.eye(4, dtype=torch.float64)[:3].repeat(2, 1, 1)
        >>> T[1, 1, 3] = 1
        >>> ball = torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0]]), torch.ones(1, 3)
        >>> light = torch.tensor([[0.0, 1, 0]])
        >>> means, covars, _ = skinned(weights, T.flatten(1), *ball, torch.zeros(1, 12), light)
        >>> means, covars
        (tensor([[0.0000, 0.5000, 0.0000]]), tensor([[1., 0., 0., 1., 0., 1.]]))
    """
    A, E = lbs_transforms(weights, T, means)
    return *_stretched(A, E, means, quats, scales), lit(sh.unflatten(1, (4, 3)), A, light)[:, 0]
