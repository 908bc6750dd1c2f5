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

from gva_mi.body.lanes import FLOATS, flat, rows
from gva_mi.splat.kernels.packets import load_rows

PIECE = 64  # Gaussians of a joint whose contributions one lane adds up
AXES = range(3)
ENTRIES = [(i, k) for i in AXES for k in range(4)]  # of a map, row by row

Lane = list[Any]  # numbers of one Gaussian


@dataclass(frozen=True)
class FollowedJoints:
    """Which joints each of N Gaussians follows, with the weights W and their derivatives.

    Attributes:
        count: N.
        first: (N + 1,) where a Gaussian's list begins in the next two, and the last one ends.
        joints: (M,) the joint of each pair of a Gaussian and a joint.
        weights: (4 M,) W and its derivatives along x, y, z, in the precision of the model.
        of_joints: the same pairs, joint by joint.
    """

    count: int
    first: UInt32
    joints: UInt32
    weights: Any
    of_joints: JointsPieces

    @staticmethod
    def of(weights: Tensor, slopes: Tensor) -> FollowedJoints:
        """Those of weights (N, J) and slopes (N, 3, J), constant from now on."""
        all_four = torch.cat([weights[:, None], slopes], dim=1)  # (N, 4, J)
        gaussians, joints = (all_four != 0).any(1).nonzero().unbind(1)
        four = all_four[gaussians, :, joints]
        Float = FLOATS[weights.dtype]
        first = torch.bincount(gaussians, minlength=len(weights)).cumsum(0)
        return FollowedJoints(
            count=len(weights),
            first=_whole(torch.cat([first.new_zeros(1), first])),
            joints=_whole(joints),
            weights=Float(four.flatten()),
            of_joints=JointsPieces.of(gaussians, joints, four),
        )

    def __call__(self, T_world_rest: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
        """A (N, 12) and E (N, 9) of eq. 1 and 2, row by row, in the precision of the means.

        Args:
            T_world_rest: (J, 4, 4) float64, the joints' maps.
            means: (N, 3) metres, at rest.

        Returns:
            Differentiable both ways.
        """
        return _Blend.apply(T_world_rest[:, :3].flatten(1), means, self)


@dataclass(frozen=True)
class JointsPieces:
    """Pairs of a Gaussian and a joint, joint by joint, in pieces of at most ``PIECE``.

    Attributes:
        first: (P + 1,) where a piece begins in the next two, and the last one ends.
        gaussians: (M,) the Gaussian of each pair.
        weights: (4 M,) as those of :class:`FollowedJoints`.
        joints: (P,) int64, whose piece it is.
    """

    first: UInt32
    gaussians: UInt32
    weights: Any
    joints: Tensor

    @staticmethod
    def of(gaussians: Tensor, joints: Tensor, four: Tensor) -> JointsPieces:
        """Those of M pairs, and their weights (M, 4)."""
        order = torch.argsort(joints, stable=True)
        within = torch.bincount(joints)
        pieces = -(-within // PIECE)
        of_piece = torch.repeat_interleave(torch.arange(len(pieces)), pieces)
        number = torch.arange(len(of_piece)) - (pieces.cumsum(0) - pieces)[of_piece]
        first = (within.cumsum(0) - within)[of_piece] + PIECE * number
        return JointsPieces(
            first=_whole(torch.cat([first, first.new_tensor([len(joints)])])),
            gaussians=_whole(gaussians[order]),
            weights=FLOATS[four.dtype](four[order].flatten()),
            joints=of_piece,
        )


def _whole(numbers: Tensor) -> UInt32:
    return UInt32(numbers.numpy().astype(np.uint32))


def _walk(first: UInt32, sums: int, add: Callable[[UInt32, Lane], Lane]) -> Lane:
    """Walk the list of each lane, adding to ``sums`` numbers, float64."""
    lane = dr.arange(UInt32, dr.width(first) - 1)
    begin, end = dr.gather(UInt32, first, lane), dr.gather(UInt32, first, lane + 1)
    zero = dr.zeros(Float64, dr.width(lane))

    def body(k: UInt32, *sums: Float64) -> tuple[Any, ...]:
        return (k + 1, *add(k, list(sums)))

    state = (begin, *(zero * 1 for _ in range(sums)))
    return dr.while_loop(state, lambda k, *_: k < end, body, mode="symbolic", compress=False)[1:]


def _four(weights: Any, k: UInt32) -> Lane:  # noqa: ANN401
    """W of a pair and its derivatives."""
    return [Float64(w) for w in load_rows(weights, 4, k)]


def _row(numbers: Any, width: int, index: UInt32) -> Lane:  # noqa: ANN401
    """A row of a flat array of such rows, float64."""
    F = type(numbers)
    if width % 4 == 0:  # aligned packets
        parts = [load_rows(numbers, 4, index * (width // 4) + part) for part in range(width // 4)]
        return [Float64(x) for part in parts for x in part]
    return [Float64(dr.gather(F, numbers, index * width + k)) for k in range(width)]


def _moved(T: Lane, mean: Lane) -> Lane:
    """T [μ; 1]."""
    return [sum(T[4 * i + k] * mean[k] for k in AXES) + T[4 * i + 3] for i in AXES]


def _forward(joints: FollowedJoints, maps: Float64, mean: Lane) -> Lane:
    """Eq. 1 and 2: A, then E."""

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(joints.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, joints.joints, k))
        x = _moved(T, mean)
        A = [dr.fma(W, value, a) for value, a in zip(T, sums[:12], strict=True)]
        E = [dr.fma(dW[c], x[i], sums[12 + 3 * i + c]) for i in AXES for c in AXES]
        return A + E

    return _walk(joints.first, 21, add)


def _turned(joints: FollowedJoints, maps: Float64, dmean: Lane) -> Lane:
    """The tangent of E along that of the means."""

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(joints.weights, k)
        T = _row(maps, 12, dr.gather(UInt32, joints.joints, k))
        dx = [sum(T[4 * i + k] * dmean[k] for k in AXES) for i in AXES]
        return [dr.fma(dW[c], dx[i], sums[3 * i + c]) for i in AXES for c in AXES]

    return _walk(joints.first, 9, add)


def _pull(dW: Lane, grad_E: Lane) -> Lane:
    """h of eq. 3."""
    return [sum(dW[c] * grad_E[3 * i + c] for c in AXES) for i in AXES]


def _adjoint_of_means(joints: FollowedJoints, maps: Float64, grad_E: Lane) -> Lane:
    """Eq. 4."""

    def add(k: UInt32, sums: Lane) -> Lane:
        _, *dW = _four(joints.weights, k)
        T, h = _row(maps, 12, dr.gather(UInt32, joints.joints, k)), _pull(dW, grad_E)
        return [sum((T[4 * i + k] * h[i] for i in AXES), sums[k]) for k in AXES]

    return _walk(joints.first, 3, add)


def _adjoint_of_maps(pieces: JointsPieces, means: Any, grad_A: Any, grad_E: Any) -> Lane:  # noqa: ANN401
    """Eq. 5, of each piece; from flat arrays."""

    def add(k: UInt32, sums: Lane) -> Lane:
        W, *dW = _four(pieces.weights, k)
        n = dr.gather(UInt32, pieces.gaussians, k)
        h, one = _pull(dW, _row(grad_E, 9, n)), [*_row(means, 3, n), 1.0]
        A = _row(grad_A, 12, n)
        return [
            s + dr.fma(W, A[4 * i + k], h[i] * one[k])
            for s, (i, k) in zip(sums, ENTRIES, strict=True)
        ]

    return _walk(pieces.first, 12, add)


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
            (pieces,) = rows([_adjoint_of_maps(joints.of_joints, *memory)], T)
            found[0] = torch.zeros_like(T).index_add(0, joints.of_joints.joints, pieces)
        if of_means:
            grad = _columns(memory[2], 9, joints.count)
            (found[1],) = rows([_adjoint_of_means(joints, flat(T), grad)], means)
        return (*found, None)

    @staticmethod
    def jvp(ctx: FunctionCtx, dT: Tensor, dmeans: Tensor, _: None) -> tuple[Tensor, Tensor]:
        T, means = ctx.saved_tensors
        dA, dE = _blended(ctx.joints, dT, means)
        if len(means):
            moved = _columns(flat(dmeans), 3, len(means))
            dE = dE + rows([_turned(ctx.joints, flat(T), moved)], means)[0]
        return dA, dE


def _blended(joints: FollowedJoints, T: Tensor, means: Tensor) -> tuple[Tensor, Tensor]:
    if not len(means):
        return means.new_zeros(0, 12), means.new_zeros(0, 9)
    found = _forward(joints, flat(T), _columns(flat(means), 3, len(means)))
    return rows([found[:12], found[12:]], means)


def _columns(numbers: Any, width: int, count: int) -> Lane:  # noqa: ANN401
    """Rows of a flat array, a lane each, float64."""
    return _row(numbers, width, dr.arange(UInt32, count))
