"""LBS transforms of Gaussians and their spatial derivatives, as Dr.Jit kernel functions.

    1. A_n  = Σ_p W_np T_p                                       Eq. 5, row by row
    2. E_nc = Σ_p ∂W_np/∂x_c T_p [μ_n; 1]                        column c of E

A Gaussian follows at most eight of the 55 joints: one lane per Gaussian iterates over the list of
its joints. The adjoint, for gradients of A and E:

    3. h_np     = Σ_c ∂W_np/∂x_c grad_E_nc
    4. grad_μ_n = Σ_p T_p,rotᵀ h_np
    5. grad_T_p = Σ_n W_np grad_A_n + h_np [μ_n; 1]ᵀ

In eq. 5 one lane adds up a piece of the list of a joint's Gaussians, and the pieces are added in
their order, so the bits do not depend on the number of threads.

Weights change by up to 100/m on fingers, and joints lie metres from the origin: E is a small
difference of large numbers, so the sums of eq. 1 and 2 are in float64. The sums of eq. 3 to 5 are
in the precision of the model, because eq. 4 has no positions of joints.

Eq. 1 is Eq. 5 of the paper; eq. 2-5 are derived here.
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

from gva_mi.jit.rowwise import Lane, load_columns, to_tensors
from gva_mi.jit.tensors import PRECISION

# Gaussians of a joint whose contributions one lane adds up. Chosen: enough lanes for all cores.
GAUSSIANS_PER_PIECE = 64
# Bound of |J - A_rot|, no unit. Chosen: cloth that is pulled to four times its length would tear.
MAX_STRETCH = 3.0
AXES = range(3)
ENTRIES = [(i, k) for i in AXES for k in range(4)]  # of a transform, row by row


@dataclass(frozen=True)
class PairLists:
    """Pairs of a Gaussian and a joint that it follows, as one list per lane of a kernel.

    Made by :meth:`SparseWeights.of`.

    Example:
        Two Gaussians; the first follows both joints, the second only one.

        >>> W = torch.tensor([[0.5, 0.5], [0.0, 1.0]])
        >>> lists = SparseWeights.of(W, slopes=torch.zeros(2, 3, 2)).of_gaussians
        >>> lists.begin, lists.end, lists.others
        ([0, 2], [2, 3], [0, 1, 1])
    """

    begin: UInt32  # (L,) start of each lane's list in the next two
    end: UInt32  # (L,) its end
    others: UInt32  # (M,) the joint of each pair if lanes are Gaussians, else its Gaussian
    weights: Any  # (4 M,) W and its derivatives along x, y, z, in the precision of the model

    @staticmethod
    def of(begin: Tensor, end: Tensor, others: Tensor, four: Tensor) -> PairLists:
        """Convert lists of M pairs with weights (M, 4) to Dr.Jit arrays."""
        whole = lambda numbers: UInt32(numbers.numpy().astype(np.uint32))
        weights = PRECISION[four.dtype](four.flatten().numpy())
        return PairLists(whole(begin), whole(end), whole(others), weights)


@dataclass(frozen=True)
class SparseWeights:
    """Skinning weights of N Gaussians and their derivatives without the zeros, constant.

    Example:
        Three Gaussians that follow the first two of 55 joints.

        >>> W = torch.zeros(3, 55)
        >>> W[:, 0], W[:, 1] = 0.25, 0.75
        >>> weights = SparseWeights.of(W, slopes=torch.zeros(3, 3, 55))
        >>> weights.gaussians, weights.joints
        (tensor([0, 0, 1, 1, 2, 2]), tensor([0, 1, 0, 1, 0, 1]))
    """

    gaussians: Tensor  # (M,) int64, the Gaussian of each pair
    joints: Tensor  # (M,) int64, its joint
    four: Tensor  # (M, 4) W and its derivatives along x, y, z
    of_gaussians: PairLists  # one list per Gaussian
    of_pieces: PairLists  # lists of at most GAUSSIANS_PER_PIECE Gaussians of one joint
    piece_joints: Tensor  # (P,) int64, the joint of each piece

    @staticmethod
    def of(weights: Tensor, slopes: Tensor) -> SparseWeights:
        """Collect the non-zero pairs of weights (N, J) and their derivatives (N, 3, J)."""
        all_four = torch.cat([weights[:, None], slopes], dim=1)  # (N, 4, J)
        gaussians, joints = (all_four != 0).any(1).nonzero().unbind(1)
        four = all_four[gaussians, :, joints]
        each = torch.bincount(gaussians, minlength=len(weights))
        of_gaussians = PairLists.of(each.cumsum(0) - each, each.cumsum(0), joints, four)

        order = torch.argsort(joints, stable=True)
        within = torch.bincount(joints)
        pieces = -(-within // GAUSSIANS_PER_PIECE)
        of_piece = torch.repeat_interleave(torch.arange(len(pieces)), pieces)
        number = torch.arange(len(of_piece)) - (pieces.cumsum(0) - pieces)[of_piece]
        begin = (within.cumsum(0) - within)[of_piece] + GAUSSIANS_PER_PIECE * number
        end = torch.minimum(begin + GAUSSIANS_PER_PIECE, within.cumsum(0)[of_piece])
        of_pieces = PairLists.of(begin, end, gaussians[order], four[order])
        return SparseWeights(gaussians, joints, four, of_gaussians, of_pieces, of_piece)


def _sums(pairs: PairLists, zero: Array, count: int, add: Callable[[UInt32, Lane], Lane]) -> Lane:
    """Iterate over the list of each lane; add to ``count`` numbers of the type of ``zero``."""
    zero = dr.zeros(type(zero), dr.width(pairs.begin))

    def body(k: UInt32, *sums: Array) -> tuple[Any, ...]:
        return (k + 1, *add(k, list(sums)))

    state = (UInt32(pairs.begin), *(zero * 1 for _ in range(count)))
    inside = lambda k, *_: k < pairs.end
    return dr.while_loop(state, inside, body, mode="symbolic", compress=False)[1:]


def _pulled(dW: Lane, grad_E: Lane) -> Lane:
    """Return h of eq. 3."""
    return [sum(dW[c] * grad_E[3 * i + c] for c in AXES) for i in AXES]


def forward(pairs: PairLists, T: Float64, mean: Lane) -> tuple[Lane, Lane]:
    """Evaluate eq. 1 and 2: A and E of each Gaussian, float64.

    Example:
        Half way between a joint at rest and one that moved by 1 m along y.

        >>> pairs = SparseWeights.of(torch.full((1, 2), 0.5), torch.zeros(1, 3, 2)).of_gaussians
        >>> T = np.stack([np.eye(4)[:3], np.eye(4)[:3]])
        >>> T[1, 1, 3] = 1
        >>> A, E = forward(pairs, Float64(T.ravel()), mean=[Float64(0)] * 3)
        >>> A[7]  # the entry of row 1, column 3
        [0.5]
    """
    mean = [Float64(x) for x in mean]

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = (Float64(x) for x in load_columns(pairs.weights, 4, k))
        T_p = load_columns(T, 12, dr.gather(UInt32, pairs.others, k))
        x = [sum(T_p[4 * i + k] * mean[k] for k in AXES) + T_p[4 * i + 3] for i in AXES]
        A = [dr.fma(W, value, a) for value, a in zip(T_p, sums[:12], strict=True)]
        E = [dr.fma(dW[c], x[i], sums[12 + 3 * i + c]) for i in AXES for c in AXES]
        return A + E

    sums = _sums(pairs, T, 21, add)
    return sums[:12], sums[12:]


def adjoint_of_means(pairs: PairLists, T: Array, grad_E: Lane) -> Lane:
    """Evaluate eq. 4, with T in the precision of the model.

    Example:
        The second joint doubles all lengths, and its weight grows along x.

        >>> from drjit.llvm import Float
        >>> slopes = torch.zeros(1, 3, 2)
        >>> slopes[0, 0] = torch.tensor([-1.0, 1.0])
        >>> pairs = SparseWeights.of(torch.full((1, 2), 0.5), slopes).of_gaussians
        >>> T = Float(np.stack([np.eye(4)[:3], 2 * np.eye(4)[:3]]).ravel())
        >>> adjoint_of_means(pairs, T, grad_E=[Float(1), *[Float(0)] * 8])
        ([1], [0], [0])
    """

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = load_columns(pairs.weights, 4, k)
        T_p = load_columns(T, 12, dr.gather(UInt32, pairs.others, k))
        h = _pulled(dW, grad_E)
        return [sum((T_p[4 * i + k] * h[i] for i in AXES), sums[k]) for k in AXES]

    return _sums(pairs, T, 3, add)


def adjoint_of_joints(pieces: PairLists, of: Callable[[UInt32], tuple[Lane, Lane, Lane]]) -> Lane:
    """Evaluate eq. 5 for each piece; ``of`` returns grad_A, grad_E and μ of a Gaussian.

    Example:
        One Gaussian that follows two joints alike: two pieces.

        >>> from drjit.llvm import Float
        >>> pieces = SparseWeights.of(torch.full((1, 2), 0.5), torch.zeros(1, 3, 2)).of_pieces
        >>> gradients = lambda gaussian: ([Float(1)] * 12, [Float(0)] * 9, [Float(0)] * 3)
        >>> adjoint_of_joints(pieces, gradients)[0]
        [0.5, 0.5]
    """

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = load_columns(pieces.weights, 4, k)
        grad_A, grad_E, mean = of(dr.gather(UInt32, pieces.others, k))
        h, one = _pulled(dW, grad_E), [*mean, 1.0]
        return [
            s + dr.fma(W, grad_A[4 * i + k], h[i] * one[k])
            for s, (i, k) in zip(sums, ENTRIES, strict=True)
        ]

    return _sums(pieces, pieces.weights, 12, add)


def add_pieces(weights: SparseWeights, sums: Array, T: Tensor) -> Tensor:
    """Add up the gradient of T (J, 12) from the sums of all pieces.

    Example:
        >>> from drjit.llvm import Float
        >>> weights = SparseWeights.of(torch.full((100, 2), 0.5), torch.zeros(100, 3, 2))
        >>> len(weights.piece_joints)  # 100 Gaussians take two pieces for each joint
        4
        >>> add_pieces(weights, Float(np.ones(4 * 12)), torch.zeros(2, 12))[:, 0]
        tensor([2., 2.])
    """
    (pieces,) = to_tensors([sums], len(weights.piece_joints))
    return pieces.new_zeros(T.shape).index_add(0, weights.piece_joints, pieces).to(T)
