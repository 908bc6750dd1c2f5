"""The blended maps of Gaussians, and how they change from place to place, by sparse products.

    A_n = Σ_p W_np T_p,     D_nc = Σ_p ∂W_np/∂x_c T_p

Of 55 joints, a Gaussian follows eight at most. With weights in rows, both are products with the
joints' maps, in which only what is not zero is multiplied; so are their adjoints, of the transpose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class SparseRows:
    """Weights (R, 55) of which nearly all are zero; constant."""

    rows: csr_array
    columns: csr_array  # the transpose

    @staticmethod
    def of(weights: Tensor) -> SparseRows:
        """Those of a tensor (R, 55)."""
        from scipy.sparse import csr_array

        rows = csr_array(weights.numpy())
        return SparseRows(rows, csr_array(rows.T))

    def __call__(self, T_world_rest: Tensor) -> Tensor:
        """The weighted sums (R, 12) of the joints' maps (55, 4, 4), differentiable both ways."""
        return _Product.apply(T_world_rest[:, :3].flatten(1), self)


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, T: Tensor, weights: SparseRows) -> Tensor:
        ctx.weights = weights
        return _times(weights.rows, T)

    @staticmethod
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None]:
        return _times(ctx.weights.columns, grad), None

    @staticmethod
    def jvp(ctx: FunctionCtx, dT: Tensor, _: None) -> Tensor:
        return _times(ctx.weights.rows, dT)


def _times(matrix: csr_array, dense: Tensor) -> Tensor:
    return torch.from_numpy(matrix @ dense.detach().contiguous().numpy())
