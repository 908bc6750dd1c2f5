"""Blend shapes: a surface plus a weighted sum of directions.

    1. x = x₀ + Σ_k c_k D_k
    2. grad_c_k = ⟨grad_x, D_k⟩,    grad_x₀ = grad_x

A body of 10,000 vertices has 58 MB of pose directions, so reading them takes most of a frame's
time. Torch multiplies a vector by a matrix on one core. Halves of the surface as a batch of two
products use two cores, take half the time, and give the same bits on any number of cores.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import pad


def as_rows(directions: np.ndarray) -> np.ndarray:
    """Convert directions (V, 3, K) to rows (K, W): all x, then all y, then all z.

    W is 3 V, padded to be even.
    """
    vertices, _, count = directions.shape
    rows = np.zeros((count, 3 * vertices + vertices % 2), directions.dtype)
    rows[:, : 3 * vertices] = directions.transpose(2, 1, 0).reshape(count, 3 * vertices)
    return rows


def as_directions(rows: np.ndarray, vertices: int) -> np.ndarray:
    """Convert rows (K, W) of :func:`as_rows` back to directions (V, 3, K)."""
    return rows[:, : 3 * vertices].reshape(len(rows), 3, vertices).transpose(2, 1, 0)


def columns_of(rows: Tensor, vertices: Tensor, count: int) -> Tensor:
    """Select ``vertices`` (n,) from rows (K, W) of ``count`` vertices."""
    some = rows[:, : 3 * count].unflatten(1, (3, count))[:, :, vertices].flatten(1)
    return pad(some, (0, some.shape[1] % 2))


def add_directions(surface: Tensor, coefficients: Tensor, directions: Tensor) -> Tensor:
    """Move a surface along directions (eq. 1).

    Args:
        surface: (1, 3 V) or (T, 3 V) metres, all x, then all y, then all z.
        coefficients: (T, K), K at most the number of directions; missing ones count as zero.
        directions: (K', W) from :func:`as_rows`.

    Returns:
        (T, 3 V), differentiable once in surface and coefficients.
    """
    return _AddDirections.apply(surface, coefficients, directions[: coefficients.shape[1]])


class _AddDirections(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, surface: Tensor, coefficients: Tensor, directions: Tensor
    ) -> Tensor:
        ctx.save_for_backward(coefficients, directions)
        ctx.save_for_forward(directions)
        ctx.shared = len(surface) < len(coefficients)
        return surface + _weighted(coefficients, directions)[:, : surface.shape[1]]

    @staticmethod
    def jvp(ctx: FunctionCtx, dsurface: Tensor, dcoefficients: Tensor, _: Tensor) -> Tensor:
        (directions,) = ctx.saved_tensors
        return dsurface + _weighted(dcoefficients, directions)[:, : dsurface.shape[1]]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, Tensor | None, None]:
        coefficients, directions = ctx.saved_tensors
        grad_coefficients = None
        if ctx.needs_input_grad[1]:
            even = pad(grad, (0, directions.shape[1] - grad.shape[1]))
            grad_coefficients = torch.bmm(_halves(even), _halves(directions).mT).sum(0)
        return grad.sum(0, keepdim=True) if ctx.shared else grad, grad_coefficients, None


def _weighted(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Return the sum of eq. 1, (T, W)."""
    moved = torch.bmm(coefficients.expand(2, -1, -1), _halves(directions))
    return moved.transpose(0, 1).flatten(1)


def _halves(rows: Tensor) -> Tensor:
    """View rows (K, W) as (2, K, W / 2)."""
    return rows.unflatten(1, (2, -1)).transpose(0, 1)
