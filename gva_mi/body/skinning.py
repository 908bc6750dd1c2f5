"""Linear blend skinning of points (Eq. 4, 5); of the frames of Gaussians: :mod:`gva_mi.body.polar`.

1. T_world_rest[j]                    one rigid map per joint: see gva_mi.body.kinematics
2. A = Σ_j w_j T_world_rest[j]        one affine map per point; a row of weights sums to 1
3. x' = A_rot x + A_trans                                                         (Eq. 5)

Source: linear blend skinning as in SMPL (Loper et al., "SMPL: A Skinned Multi-Person Linear Model",
2015, eq. 2).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND

# Frames per block of skin_points. Chosen: 4 × 10,000 blended transforms are 2 MB, which fit into a
# core's cache.
_FRAMES_PER_BLOCK = 4


def skin_points(points: Tensor, weights: Tensor, T_world_rest: Tensor) -> Tensor:
    """Move points from the rest pose to the world (eq. 2, 3), for one pose or T poses.

    Args:
        points: (N, 3), or (T, N, 3) if they differ between poses.
        weights: (N, J), rows sum to 1.
        T_world_rest: (J, 4, 4) for a result (N, 3), or (T, J, 4, 4) for (T, N, 3).

    Returns:
        The moved points, metres, differentiable once in all arguments.

    Example:
        A point that follows two joints alike moves by the mean of their transforms.

        >>> still, raised = torch.eye(4), torch.eye(4)
        >>> raised[1, 3] = 1  # one metre up
        >>> skin_points(torch.zeros(1, 3), torch.tensor([[0.5, 0.5]]), torch.stack([still, raised]))
        tensor([[0.0000, 0.5000, 0.0000]])
    """
    many = T_world_rest.ndim == 4
    T = T_world_rest if many else T_world_rest.unsqueeze(0)
    points = points if points.ndim == 3 else points.unsqueeze(0)
    skinned = _SkinPoints.apply(points, weights, T[:, :, :3].flatten(2).mT)
    return skinned if many else skinned.squeeze(0)


class _SkinPoints(torch.autograd.Function):
    """Eq. 2 and 3 in blocks of frames, so that blended transforms stay in the cache.

    Coordinates are the first axis and points the last, so sums run along memory. Autograd's adjoint
    would fill a transform of zeros for each of its 12 entries.
    """

    @staticmethod
    def forward(ctx: FunctionCtx, points: Tensor, weights: Tensor, maps: Tensor) -> Tensor:
        """Skin points (T or 1, N, 3) by weights (N, J) and joint transforms (T, 12, J)."""
        frames, n = len(maps), len(weights)
        x = points.mT  # (T or 1, 3, N)
        out = points.new_empty(frames, n, 3)
        blended = []
        for part in _parts(frames):
            A = (maps[part].reshape(-1, maps.shape[2]) @ weights.T).view(-1, 3, 4, n)
            moved = A[:, :, 3].clone()
            for k in range(3):
                moved.addcmul_(A[:, :, k], _of(x, part)[:, None, k])
            out[part] = moved.mT
            blended.append(A)
        ctx.save_for_backward(points, weights, maps, *blended)
        ctx.save_for_forward(points, weights, maps)
        return out

    @staticmethod
    def jvp(ctx: FunctionCtx, dpoints: Tensor, dweights: Tensor, dmaps: Tensor) -> Tensor:
        points, weights, maps = ctx.saved_tensors[:3]
        blend = lambda maps, weights: (maps @ weights.T).unflatten(1, (3, 4))  # (T, 3, 4, N)
        A, dA = blend(maps, weights), blend(dmaps, weights) + blend(maps, dweights)
        turned = lambda A, x: torch.einsum("tikn,tnk->tni", A[:, :, :3], x.expand(len(A), -1, -1))
        return turned(A, dpoints) + turned(dA, points) + dA[:, :, 3].mT

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad_out: Tensor) -> tuple[Tensor | None, ...]:
        points, weights, maps, *blended = ctx.saved_tensors
        wanted_points, wanted_weights, wanted_maps = ctx.needs_input_grad
        n, x = len(weights), points.mT
        each = len(x) == len(maps)  # otherwise all frames share one x and its gradient
        grad_x = x.new_empty(x.shape) if each else x.new_zeros(x.shape)
        grad_weights = torch.zeros_like(weights) if wanted_weights else None
        grad_maps = torch.empty_like(maps) if wanted_maps else None
        for part, A in zip(_parts(len(maps)), blended, strict=True):
            g = grad_out[part].mT.contiguous()  # (t, 3, N)
            if wanted_points:  # grad_x = A_rotᵀ grad_x'
                pulled = A[:, 0, :3] * g[:, :1]
                for i in (1, 2):
                    pulled.addcmul_(A[:, i, :3], g[:, i : i + 1])
                if each:
                    grad_x[part] = pulled
                else:
                    grad_x += pulled.sum(0)
            if wanted_weights or wanted_maps:  # grad_A = grad_x' [x | 1]ᵀ
                grad_A = torch.empty_like(A)
                torch.mul(g[:, :, None], _of(x, part)[:, None], out=grad_A[:, :, :3])
                grad_A[:, :, 3] = g
                grad_A = grad_A.view(-1, n)
                if wanted_maps:
                    grad_maps[part] = (grad_A @ weights).view_as(maps[part])
                if wanted_weights:
                    grad_weights += grad_A.T @ maps[part].reshape(-1, maps.shape[2])
        return grad_x.mT if wanted_points else None, grad_weights, grad_maps


def _parts(frames: int) -> list[slice]:
    starts = range(0, frames, _FRAMES_PER_BLOCK)
    return [slice(start, start + _FRAMES_PER_BLOCK) for start in starts]


def _of(x: Tensor, part: slice) -> Tensor:
    """Select frames of points, which may be shared by all frames."""
    return x if len(x) == 1 else x[part]


def finger_weights(weights: Tensor) -> Tensor:
    """Return the share of each row of skinning weights (N, 55) that belongs to fingers, (N,).

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> share = finger_weights(load_body().weights)
        >>> print(f"{(share > 0.5).float().mean():.0%} of the vertices are on fingers")
        20% of the vertices are on fingers
    """
    return weights[:, LEFT_HAND].sum(1) + weights[:, RIGHT_HAND].sum(1)


def strongest(weights: Tensor, joints: int = 4) -> Tensor:
    """Keep the largest weights of each row (N, J), the first of equal ones, scaled to sum 1.

    Example:
        >>> strongest(torch.tensor([[0.5, 0.3, 0.2]]), joints=2)
        tensor([[0.6250, 0.3750, 0.0000]])
    """
    order = torch.sort(weights, dim=1, descending=True, stable=True).indices[:, :joints]
    kept = torch.zeros_like(weights).scatter(1, order, weights.gather(1, order))
    return kept / kept.sum(1, keepdim=True)
