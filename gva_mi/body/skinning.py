"""Linear blend skinning of points (Eq. 4, 5); of the frames of Gaussians: :mod:`gva_mi.body.polar`.

1. T_world_rest[j]                    one rigid map per joint: see gva_mi.body.kinematics
2. A = Σ_j w_j T_world_rest[j]        one affine map per point; a row of weights sums to 1
3. x' = A_rot x + A_trans                                                         (Eq. 5)
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND

_FRAMES = 4  # frames per block of skin_points; 10k blended transforms take 0.5 MB


def skin_points(points: Tensor, weights: Tensor, T_world_rest: Tensor) -> Tensor:
    """Move points from the rest pose to the world (eq. 2, 3), for one pose or T poses.

    Args:
        points: (N, 3), or (T, N, 3) if they differ between poses.
        weights: (N, J), rows sum to 1.
        T_world_rest: (J, 4, 4) for a result (N, 3), or (T, J, 4, 4) for (T, N, 3).
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
        return out

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
    return [slice(start, start + _FRAMES) for start in range(0, frames, _FRAMES)]


def _of(x: Tensor, part: slice) -> Tensor:
    """Select frames of points, which may be shared by all frames."""
    return x if len(x) == 1 else x[part]


def finger_weights(weights: Tensor) -> Tensor:
    """Return the share of each row of skinning weights (N, 55) that belongs to fingers, (N,)."""
    return weights[:, LEFT_HAND].sum(1) + weights[:, RIGHT_HAND].sum(1)


def strongest(weights: Tensor, joints: int = 4) -> Tensor:
    """Keep the largest weights of each row (N, J), the first of equal ones, scaled to sum 1."""
    order = torch.sort(weights, dim=1, descending=True, stable=True).indices[:, :joints]
    kept = torch.zeros_like(weights).scatter(1, order, weights.gather(1, order))
    return kept / kept.sum(1, keepdim=True)
