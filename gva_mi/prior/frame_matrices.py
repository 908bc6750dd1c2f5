"""Matrices over the frames of a clip, such as a precision, and their products with vectors.

    1. y = M x,    grad_x = Mᵀ grad_y        M (C, n, n), x and y (C, n, d)

x has a column for each axis. With so few columns MKL takes four times as long for eq. 1 as for
``yᵀ = xᵀ Mᵀ`` with a matrix that lies row by row in memory. Therefore Mᵀ is kept beside M.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx


@dataclass(frozen=True)
class FrameMatrices:
    """C constant matrices over n frames, as they are and transposed, each (C, n, n)."""

    M: Tensor
    transposed: Tensor

    @staticmethod
    def of(M: Tensor) -> FrameMatrices:
        """Keep matrices (C, n, n) in both layouts."""
        return FrameMatrices(M.contiguous(), M.mT.contiguous())

    def __matmul__(self, x: Tensor) -> Tensor:
        """Return M x, (C, n, d), differentiable once in x (C, n, d)."""
        # Of a single column both forms are a product with a vector, whose orders differ.
        return self.M @ x if x.shape[-1] == 1 else _Product.apply(x, self)

    def product(self, x: Tensor, frames: list[int]) -> Tensor:
        """Return the rows of M x of r frames, (C, r, d)."""
        return self @ x if self._are_all(frames) else self.M[:, frames] @ x

    def rows(self, frames: list[int]) -> Tensor:
        """Return the rows of M of r frames, (C, r, n); of all frames without a copy."""
        return self.M if self._are_all(frames) else self.M[:, frames]

    def _are_all(self, frames: list[int]) -> bool:
        return frames == list(range(self.M.shape[1]))


class _Product(torch.autograd.Function):
    """Eq. 1."""

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, matrices: FrameMatrices) -> Tensor:
        ctx.matrices = matrices
        return _transposed(_transposed(x) @ matrices.transposed)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None]:
        return _transposed(_transposed(grad) @ ctx.matrices.M), None


def _transposed(x: Tensor) -> Tensor:
    return x.mT.contiguous()
