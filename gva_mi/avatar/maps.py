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
from drjit.llvm import Float64, UInt32
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.body.lanes import FLOATS, flat, in_rows, of_rows, tensors
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.kernels.frozen import Frozen

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
            whole(begin), whole(end), whole(others), FLOATS[four.dtype](four.flatten().numpy())
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


def _walk(pairs: Pairs, sums: int, add: Callable[[UInt32, Lane], Lane]) -> Lane:
    """Walk the list of each lane, adding to ``sums`` numbers, float64."""
    zero = dr.zeros(Float64, dr.width(pairs.begin))

    def body(k: UInt32, *sums: Float64) -> tuple[Any, ...]:
        return (k + 1, *add(k, list(sums)))

    state = (UInt32(pairs.begin), *(zero * 1 for _ in range(sums)))
    inside = lambda k, *_: k < pairs.end
    return dr.while_loop(state, inside, body, mode="symbolic", compress=False)[1:]


def _four(weights: Any, k: UInt32) -> Lane:  # noqa: ANN401
    """W of a pair and its derivatives."""
    return [Float64(w) for w in of_rows(weights, 4, k)]


def _row(numbers: Any, width: int, index: UInt32) -> Lane:  # noqa: ANN401
    """A row of a flat array of such rows, float64."""
    return [Float64(x) for x in of_rows(numbers, width, index)]


def _own(numbers: Any, width: int, n: int) -> Lane:  # noqa: ANN401
    """Each lane's own row."""
    return _row(numbers, width, dr.arange(UInt32, n))


def _moved(T: Lane, mean: Lane) -> Lane:
    """T [μ; 1]."""
    return [sum(T[4 * i + k] * mean[k] for k in AXES) + T[4 * i + 3] for i in AXES]


@Frozen
def _forward(pairs: Pairs, maps: Float64, means: Any, *, n: int) -> list[Any]:  # noqa: ANN401
    """Eq. 1 and 2: A and E, as flat arrays of rows, from such."""
    mean = _own(means, 3, n)

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(pairs.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, pairs.others, k))
        x = _moved(T, mean)
        A = [dr.fma(W, value, a) for value, a in zip(T, sums[:12], strict=True)]
        E = [dr.fma(dW[c], x[i], sums[12 + 3 * i + c]) for i in AXES for c in AXES]
        return A + E

    sums = _walk(pairs, 21, add)
    return _evaluated([in_rows(some, n, type(means)) for some in (sums[:12], sums[12:])])


@Frozen
def _turned(pairs: Pairs, maps: Float64, dmeans: Any, *, n: int) -> list[Any]:  # noqa: ANN401
    """The tangent of E along that of the means."""
    dmean = _own(dmeans, 3, n)

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(pairs.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, pairs.others, k))
        dx = [sum(T[4 * i + k] * dmean[k] for k in AXES) for i in AXES]
        return [dr.fma(dW[c], dx[i], sums[3 * i + c]) for i in AXES for c in AXES]

    return _evaluated([in_rows(_walk(pairs, 9, add), n, type(dmeans))])


def _pull(dW: Lane, grad_E: Lane) -> Lane:
    """h of eq. 3."""
    return [sum(dW[c] * grad_E[3 * i + c] for c in AXES) for i in AXES]


@Frozen
def _adjoint_of_means(
    pairs: Pairs,
    maps: Float64,
    grad_Es: Any,  # noqa: ANN401
    *,
    n: int,
) -> list[Any]:
    """Eq. 4."""
    grad_E = _own(grad_Es, 9, n)

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(pairs.weights, k)
        T, h = _row(maps, 12, dr.gather(UInt32, pairs.others, k)), _pull(dW, grad_E)
        return [sum((T[4 * i + k] * h[i] for i in AXES), sums[k]) for k in AXES]

    return _evaluated([in_rows(_walk(pairs, 3, add), n, type(grad_Es))])


@Frozen
def _adjoint_of_maps(
    pieces: Pairs,
    means: Any,  # noqa: ANN401
    grad_A: Any,  # noqa: ANN401
    grad_E: Any,  # noqa: ANN401
    *,
    n: int,
) -> list[Any]:
    """Eq. 5, of each piece; float64."""

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(pieces.weights, k)
        n = dr.gather(UInt32, pieces.others, k)
        h, one = _pull(dW, _row(grad_E, 9, n)), [*_row(means, 3, n), 1.0]
        A = _row(grad_A, 12, n)
        return [
            s + dr.fma(W, A[4 * i + k], h[i] * one[k])
            for s, (i, k) in zip(sums, ENTRIES, strict=True)
        ]

    return _evaluated([in_rows(_walk(pieces, 12, add), n, Float64)])


def _evaluated(arrays: list[Any]) -> list[Any]:
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
        return _blended(joints, T, means)

    @staticmethod
    @torch.autograd.function.once_differentiable
    @exclusive
    def backward(
        ctx: FunctionCtx, grad_A: Tensor, grad_E: Tensor
    ) -> tuple[Tensor | None, Tensor | None, None]:
        T, means = ctx.saved_tensors
        of_T, of_means, _ = ctx.needs_input_grad
        joints, memory = ctx.joints, [flat(x) for x in (means, grad_A, grad_E)]
        if not len(means):
            return torch.zeros_like(T), torch.zeros_like(means), None
        found = [None, None]
        if of_T:
            count = len(joints.joints)
            (pieces,) = tensors(_adjoint_of_maps(joints.of_pieces, *memory, n=count), count)
            found[0] = pieces.new_zeros(T.shape).index_add(0, joints.joints, pieces).to(T)
        if of_means:
            sums = _adjoint_of_means(joints.of_gaussians, flat(T), memory[2], n=len(means))
            (found[1],) = tensors(sums, len(means))
        return (*found, None)

    @staticmethod
    @exclusive
    def jvp(ctx: FunctionCtx, dT: Tensor, dmeans: Tensor, _: None) -> tuple[Tensor, Tensor]:
        T, means = ctx.saved_tensors
        dA, dE = _blended(ctx.joints, dT, means)
        if len(means):
            turned = _turned(ctx.joints.of_gaussians, flat(T), flat(dmeans), n=len(means))
            dE = dE + tensors(turned, len(means))[0]
        return dA, dE


@exclusive
def _blended(joints: FollowedJoints, T: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
    if not len(means):
        return means.new_zeros(0, 12), means.new_zeros(0, 9)
    n = len(means)
    return tensors(_forward(joints.of_gaussians, flat(T), flat(means), n=n), n)
