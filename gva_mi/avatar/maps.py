"""Blended maps of Gaussians, and how they change from place to place: Dr.Jit kernels.

    1. A_n  = Σ_p W_np T_p                                       Eq. 5, row by row
    2. E_nc = Σ_p ∂W_np/∂x_c T_p [μ_n; 1]                        column c of E

Of 55 joints a Gaussian follows eight at most: a lane is a Gaussian, and walks the list of its
joints. The adjoint, for gradients of A and E:

    3. h_np     = Σ_c ∂W_np/∂x_c grad_E_nc
    4. grad_μ_n = Σ_p T_p,rotᵀ h_np
    5. grad_T_p = Σ_n W_np grad_A_n + h_np [μ_n; 1]ᵀ

In eq. 5 a lane is a piece of the list of a joint's Gaussians, and the sums of its pieces are added
up in their order: the same bits for any number of threads.

Weights change by up to a hundred a metre, on fingers, and joints lie metres from the origin: E is a
small difference of large numbers, and all sums are in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float64, UInt32
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.frozen import Frozen
from gva_mi.jit.rowwise import flat, in_rows, of_rows, tensors
from gva_mi.jit.tensors import PRECISION

PIECE = 64  # Gaussians of a joint whose contributions one lane adds up
AXES = range(3)
ENTRIES = [(i, k) for i in AXES for k in range(4)]  # of a map, row by row

Lane = list[Any]  # numbers of one Gaussian


@dataclass(frozen=True)
class Pairs:
    """Pairs of a Gaussian and a joint that it follows, in a list for each lane of a kernel.

    Attributes:
        begin: (L,) where a lane's list begins in the next two.
        end: (L,) where it ends.
        others: (M,) the joint of each pair where a lane is a Gaussian, and the other way round.
        weights: (4 M,) W and its derivatives along x, y, z, in the precision of the model.
    """

    begin: UInt32
    end: UInt32
    others: UInt32
    weights: Any

    @staticmethod
    def of(begin: Tensor, end: Tensor, others: Tensor, four: Tensor) -> Pairs:
        """Those of M pairs with their weights (M, 4)."""
        whole = lambda numbers: UInt32(numbers.numpy().astype(np.uint32))
        return Pairs(
            whole(begin), whole(end), whole(others), PRECISION[four.dtype](four.flatten().numpy())
        )


@dataclass(frozen=True)
class FollowedJoints:
    """Which joints each of N Gaussians follows, constant.

    Attributes:
        of_gaussians: a list for each Gaussian.
        of_pieces: lists of at most ``PIECE`` Gaussians of one joint.
        joints: (P,) int64, whose pieces these are.
    """

    of_gaussians: Pairs
    of_pieces: Pairs
    joints: Tensor

    @staticmethod
    def of(weights: Tensor, slopes: Tensor) -> FollowedJoints:
        """Those of weights (N, J) and their derivatives (N, 3, J)."""
        all_four = torch.cat([weights[:, None], slopes], dim=1)  # (N, 4, J)
        gaussians, joints = (all_four != 0).any(1).nonzero().unbind(1)
        four = all_four[gaussians, :, joints]
        each = torch.bincount(gaussians, minlength=len(weights))
        of_gaussians = Pairs.of(each.cumsum(0) - each, each.cumsum(0), joints, four)

        order = torch.argsort(joints, stable=True)
        within = torch.bincount(joints)
        pieces = -(-within // PIECE)
        of_piece = torch.repeat_interleave(torch.arange(len(pieces)), pieces)
        number = torch.arange(len(of_piece)) - (pieces.cumsum(0) - pieces)[of_piece]
        begin = (within.cumsum(0) - within)[of_piece] + PIECE * number
        end = torch.minimum(begin + PIECE, within.cumsum(0)[of_piece])
        of_pieces = Pairs.of(begin, end, gaussians[order], four[order])
        return FollowedJoints(of_gaussians, of_pieces, of_piece)

    def __call__(self, T_world_rest: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
        """A (N, 12) and E (N, 9) of eq. 1 and 2, row by row, in the precision of the means.

        Args:
            T_world_rest: (J, 4, 4) float64, the joints' maps.
            means: (N, 3) metres, at rest.

        Returns:
            Differentiable both ways.
        """
        return _Blend.apply(T_world_rest[:, :3].flatten(1), means, self)

    @exclusive
    def blended(self, T: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
        """The same of maps T (J, 12), without gradients."""
        n = len(means)
        if not n:
            return means.new_zeros(0, 12), means.new_zeros(0, 9)
        return tensors(_blend(self.of_gaussians, flat(T), flat(means), n=n), n)

    @exclusive
    def tangent(
        self, T: Tensor, means: Tensor, dT: Tensor, dmeans: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The tangents of A and E."""
        dA, dE = self.blended(dT, means)
        n = len(means)
        if not n:
            return dA, dE
        (turn,) = tensors(_turned(self.of_gaussians, flat(T), flat(dmeans), n=n), n)
        return dA, dE + turn


def _walk(pairs: Pairs, sums: int, add: Callable[[UInt32, Lane], Lane]) -> Lane:
    """Walk the list of each lane, adding to ``sums`` numbers, float64."""
    zero = dr.zeros(Float64, dr.width(pairs.begin))

    def body(k: UInt32, *sums: Float64) -> tuple[Any, ...]:
        return (k + 1, *add(k, list(sums)))

    state = (UInt32(pairs.begin), *(zero * 1 for _ in range(sums)))
    inside = lambda k, *_: k < pairs.end
    return dr.while_loop(state, inside, body, mode="symbolic", compress=False)[1:]


def _four(weights: Array, k: UInt32) -> Lane:
    """W of a pair and its derivatives."""
    return [Float64(w) for w in of_rows(weights, 4, k)]


def _row(numbers: Array, width: int, index: UInt32) -> Lane:
    """A row of a flat array of such rows, float64."""
    return [Float64(x) for x in of_rows(numbers, width, index)]


def _moved(T: Lane, mean: Lane) -> Lane:
    """T [μ; 1]."""
    return [sum(T[4 * i + k] * mean[k] for k in AXES) + T[4 * i + 3] for i in AXES]


def blend(pairs: Pairs, maps: Float64, mean: Lane) -> tuple[Lane, Lane]:
    """Eq. 1 and 2: A and E of each Gaussian, float64."""
    mean = [Float64(x) for x in mean]

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(pairs.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, pairs.others, k))
        x = _moved(T, mean)
        A = [dr.fma(W, value, a) for value, a in zip(T, sums[:12], strict=True)]
        E = [dr.fma(dW[c], x[i], sums[12 + 3 * i + c]) for i in AXES for c in AXES]
        return A + E

    sums = _walk(pairs, 21, add)
    return sums[:12], sums[12:]


def turned(pairs: Pairs, maps: Float64, dmean: Lane) -> Lane:
    """The tangent of E along that of the mean."""
    dmean = [Float64(x) for x in dmean]

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(pairs.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, pairs.others, k))
        dx = [sum(T[4 * i + k] * dmean[k] for k in AXES) for i in AXES]
        return [dr.fma(dW[c], dx[i], sums[3 * i + c]) for i in AXES for c in AXES]

    return _walk(pairs, 9, add)


def _pull(dW: Lane, grad_E: Lane) -> Lane:
    """h of eq. 3."""
    return [sum(dW[c] * grad_E[3 * i + c] for c in AXES) for i in AXES]


def adjoint_of_means(pairs: Pairs, maps: Float64, grad_E: Lane) -> Lane:
    """Eq. 4."""
    grad_E = [Float64(x) for x in grad_E]

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(pairs.weights, k)
        T, h = _row(maps, 12, dr.gather(UInt32, pairs.others, k)), _pull(dW, grad_E)
        return [sum((T[4 * i + k] * h[i] for i in AXES), sums[k]) for k in AXES]

    return _walk(pairs, 3, add)


def adjoint_of_maps(pieces: Pairs, of: Callable[[UInt32], tuple[Lane, Lane, Lane]]) -> Lane:
    """Eq. 5, of each piece.

    Args:
        pieces: lists of Gaussians.
        of: grad_A, grad_E and μ of a Gaussian.
    """

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(pieces.weights, k)
        found = of(dr.gather(UInt32, pieces.others, k))
        grad_A, grad_E, mean = ([Float64(x) for x in some] for some in found)
        h, one = _pull(dW, grad_E), [*mean, 1.0]
        return [
            s + dr.fma(W, grad_A[4 * i + k], h[i] * one[k])
            for s, (i, k) in zip(sums, ENTRIES, strict=True)
        ]

    return _walk(pieces, 12, add)


def add_pieces(joints: FollowedJoints, sums: Array, T: Tensor) -> Tensor:
    """The gradient by the maps T (J, 12), from the sums of all pieces."""
    (pieces,) = tensors([sums], len(joints.joints))
    return pieces.new_zeros(T.shape).index_add(0, joints.joints, pieces).to(T)


@Frozen
def _blend(pairs: Pairs, maps: Float64, means: Array, *, n: int) -> list[Array]:
    F, lane = type(means), dr.arange(UInt32, n)
    return _evaluated([in_rows(x, n, F) for x in blend(pairs, maps, of_rows(means, 3, lane))])


@Frozen
def _turned(pairs: Pairs, maps: Float64, dmeans: Array, *, n: int) -> list[Array]:
    found = turned(pairs, maps, of_rows(dmeans, 3, dr.arange(UInt32, n)))
    return _evaluated([in_rows(found, n, type(dmeans))])


@Frozen
def _adjoint_of_means(pairs: Pairs, maps: Float64, grad_E: Array, *, n: int) -> list[Array]:
    found = adjoint_of_means(pairs, maps, of_rows(grad_E, 9, dr.arange(UInt32, n)))
    return _evaluated([in_rows(found, n, type(grad_E))])


@Frozen
def _adjoint_of_maps(
    pieces: Pairs, grad_A: Array, grad_E: Array, means: Array, *, n: int
) -> list[Array]:
    rows = (grad_A, 12), (grad_E, 9), (means, 3)
    found = adjoint_of_maps(pieces, lambda k: tuple(of_rows(x, width, k) for x, width in rows))
    return _evaluated([in_rows(found, n, Float64)])


def _evaluated(arrays: list[Array]) -> list[Array]:
    dr.eval(arrays)
    return arrays


class _Blend(torch.autograd.Function):
    """From T (J, 12) float64 and means (N, 3) to A (N, 12) and E (N, 9)."""

    @staticmethod
    def forward(
        ctx: FunctionCtx, T: Tensor, means: Tensor, joints: FollowedJoints
    ) -> tuple[Tensor, Tensor]:
        ctx.joints = joints
        ctx.save_for_backward(T, means)
        ctx.save_for_forward(T, means)
        return joints.blended(T, means)

    @staticmethod
    @torch.autograd.function.once_differentiable
    @exclusive
    def backward(ctx: FunctionCtx, grad_A: Tensor, grad_E: Tensor) -> tuple[Tensor, Tensor, None]:
        T, means = ctx.saved_tensors
        joints, n = ctx.joints, len(means)
        if not n:
            return torch.zeros_like(T), torch.zeros_like(means), None
        A, E, x = (flat(tensor) for tensor in (grad_A, grad_E, means))
        (by_maps,) = _adjoint_of_maps(joints.of_pieces, A, E, x, n=len(joints.joints))
        by_means = _adjoint_of_means(joints.of_gaussians, flat(T), E, n=n)
        return add_pieces(joints, by_maps, T), tensors(by_means, n)[0], None

    @staticmethod
    def jvp(ctx: FunctionCtx, dT: Tensor, dmeans: Tensor, _: None) -> tuple[Tensor, Tensor]:
        return ctx.joints.tangent(*ctx.saved_tensors, dT, dmeans)
