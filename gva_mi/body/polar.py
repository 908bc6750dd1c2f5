"""The rotation nearest to a blend of rotations, with exact gradients: one Dr.Jit kernel each way.

Eq. 6 of the paper multiplies a Gaussian's rotation by A_rot, the linear part of its LBS transform,
as if it were a rotation. It is a blend of rotations, which shears and shrinks wherever its joints
turn differently. Here means follow the whole transform and stay on the skinned mesh, while
orientations follow the rotation nearest to A_rot, its polar factor. Gaussians keep their learned
scales, and rigid motions are exact.

For a rotation R with quaternion r (wxyz), ``r rᵀ`` is *linear* in R (Davenport's matrix):

    1. B(A) = (I + K(A)) / 4,    K linear,    B(R) = r rᵀ
    2. A_rot = Σ w_p R_p   ⇒   B = Σ w_p r_p r_pᵀ    eigenvalues in [0, 1], their sum is 1
    3. q = the eigenvector of B's largest eigenvalue λ

q maximises qᵀ B q, hence tr(R(q)ᵀ A): it is the polar factor of A_rot, and also Markley's average
of the quaternions, in which the signs of r_p play no part. Squaring B and scaling it to trace 1,
again and again, leaves q qᵀ. With a unit q, perturbation theory gives the derivative, its
transpose the adjoint:

    4. dq = (λ I − B)⁺ dB q
    5. y = (λ I − B)⁺ grad_q,    grad_B = y qᵀ,    grad_A = Kᵀ(grad_B) / 4

The pseudo-inverse acts on what is orthogonal to q, where it equals the inverse of ``λ I − B + q
qᵀ``: a positive definite 4x4 system, solved by Cholesky's method. Where two eigenvalues meet
(joints turned against each other by 180°) no nearest rotation is unique; there the pivots are held
above :data:`MIN_GAP`, so that gradients stay finite.

=============  =========================================================  ===========
Symbol         Meaning                                                    Shape
=============  =========================================================  ===========
A              blended affine map, rows of [A_rot | A_trans]              (N, 12)
means, quats   Gaussians in the rest pose; quaternions wxyz               (N, 3 | 4)
B              average of the joints' quaternion outer products           4x4 a lane
q              polar factor of A_rot as a unit quaternion                 4 a lane
=============  =========================================================  ===========

Sources: Keat, "Analysis of least-squares attitude determination routine DOAOP", 1977 (Davenport's
q-method); Markley, Cheng, Crassidis and Oshman, "Averaging Quaternions", 2007. Eq. 4 is the
derivative of an eigenvector (Magnus, "On differentiating eigenvalues and eigenvectors", 1985).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.rowwise import launch
from gva_mi.jit.tensors import PRECISION

# Chosen: B^512, in which the second eigenvalue vanishes in float64 for joints up to 170° apart.
SQUARINGS = 9
# Smallest pivot of the adjoint's system, no unit: eigenvalues are in [0, 1]. Chosen: it limits a
# gradient's growth to 10,000 times where joints are turned against each other by 180°.
MIN_GAP = 1e-4

_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]  # upper triangle of a symmetric 4x4


def apply_lbs(A: Tensor, means: Tensor, quats: Tensor) -> tuple[Tensor, Tensor]:
    """Apply LBS transforms to Gaussians: ``A_rot m + A_trans`` and ``polar(A_rot) ⊗ quat``.

    Args:
        A: (N, 12) LBS transforms [A_rot | A_trans] (skinning.py, eq. 2), row by row.
        means: (N, 3).
        quats: (N, 4) wxyz; their lengths are kept.

    Returns:
        means (N, 3) and quats (N, 4), differentiable in everything.

    Example:
        The mean of no turn and a quarter turn about z shrinks A_rot; the orientation is turned by
        45° and stays a rotation.

        >>> blend = (torch.eye(3) + torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])) / 2
        >>> A = torch.cat([blend, torch.zeros(3, 1)], 1).view(1, 12)
        >>> means, quats = apply_lbs(A, torch.tensor([[1.0, 0, 0]]), torch.tensor([[1.0, 0, 0, 0]]))
        >>> means, 2 * torch.rad2deg(torch.acos(quats[0, 0])).round(decimals=3)
        (tensor([[0.5000, 0.5000, 0.0000]]), tensor(45.))
    """
    if A.dtype not in PRECISION:
        raise ValueError(f"apply_lbs(): expected float32 or float64, got {A.dtype}")
    return _ApplyLbs.apply(A, means, quats)


# --- formulas, one lane per Gaussian ---


def _davenport(A: list[Any], one: float = 1) -> dict[tuple[int, int], Any]:
    """Return the upper triangle of B(A), eq. 1, from the nine entries of A_rot.

    If ``one`` is zero, it is the linear part K(A) / 4.
    """
    a, b, c, d, e, f, g, h, i = A
    return {
        (0, 0): 0.25 * (one + a + e + i), (1, 1): 0.25 * (one + a - e - i),
        (2, 2): 0.25 * (one - a + e - i), (3, 3): 0.25 * (one - a - e + i),
        (0, 1): 0.25 * (h - f), (0, 2): 0.25 * (c - g), (0, 3): 0.25 * (d - b),
        (1, 2): 0.25 * (b + d), (1, 3): 0.25 * (c + g), (2, 3): 0.25 * (f + h),
    }  # fmt: skip


def _davenport_adjoint(G: list[list[Any]]) -> list[Any]:
    """Adjoint of :func:`_davenport`, from a full 4x4 ``G`` to the nine entries of A_rot."""
    s = lambda i, j: G[i][j] + G[j][i]  # an entry off the diagonal stands twice in B
    w, x, y, z = (G[k][k] for k in range(4))
    return [0.25 * v for v in (
        w + x - y - z, s(1, 2) - s(0, 3), s(0, 2) + s(1, 3),
        s(0, 3) + s(1, 2), w - x + y - z, s(2, 3) - s(0, 1),
        s(1, 3) - s(0, 2), s(0, 1) + s(2, 3), w - x - y + z,
    )]  # fmt: skip


def _top_eigenvector(B: dict[tuple[int, int], Any]) -> list[Any]:
    """Return q of eq. 3, with a positive largest entry."""
    at = lambda M, i, j: M[(i, j) if i <= j else (j, i)]
    for _ in range(SQUARINGS):
        scale = dr.rcp(B[0, 0] + B[1, 1] + B[2, 2] + B[3, 3])
        B = {pair: value * scale for pair, value in B.items()}
        B = {(i, j): sum(at(B, i, k) * at(B, k, j) for k in range(4)) for i, j in _PAIRS}
    q, best = [at(B, i, 0) for i in range(4)], B[0, 0]  # the column with the largest diagonal entry
    for column in (1, 2, 3):
        larger = B[column, column] > best
        q = [dr.select(larger, at(B, i, column), q[i]) for i in range(4)]
        best = dr.maximum(best, B[column, column])
    scale = 1 / dr.sqrt(sum(v * v for v in q))
    return [v * scale for v in q]


def _project_and_solve(B: dict[tuple[int, int], Any], q: list[Any], g: list[Any]) -> list[Any]:
    """Return ``(λ I − B)⁺ g`` of eq. 4 and 5, by LDLᵀ of ``λ I − B + q qᵀ``."""
    at = lambda i, j: B[(i, j) if i <= j else (j, i)]
    Bq = [sum(at(i, k) * q[k] for k in range(4)) for i in range(4)]
    eigenvalue = sum(q[i] * Bq[i] for i in range(4))
    along = sum(q[i] * g[i] for i in range(4))
    g = [g[i] - along * q[i] for i in range(4)]

    L, pivot, y = {}, [], list(g)
    for j in range(4):
        entry = lambda i, j=j: (
            (eigenvalue if i == j else 0)
            - at(i, j)
            + q[i] * q[j]
            - sum(L[i, k] * L[j, k] * pivot[k] for k in range(j))
        )
        L[j, j] = 1
        pivot.append(dr.maximum(entry(j), MIN_GAP))
        for i in range(j + 1, 4):
            L[i, j] = entry(i) / pivot[j]
    for i in range(4):
        y[i] = y[i] - sum(L[i, k] * y[k] for k in range(i))
    y = [y[i] / pivot[i] for i in range(4)]
    for i in reversed(range(4)):
        y[i] = y[i] - sum(L[k, i] * y[k] for k in range(i + 1, 4))
    along = sum(q[i] * y[i] for i in range(4))
    return [y[i] - along * q[i] for i in range(4)]


def _multiply(p: list[Any], q: list[Any]) -> list[Any]:
    """Return Hamilton's product p ⊗ q."""
    return [
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    ]


def _conjugate(q: list[Any]) -> list[Any]:
    return [q[0], -q[1], -q[2], -q[3]]


# --- kernels ---


def _forward(A: list[Any], mean: list[Any], quat: list[Any]) -> tuple[list[Any], list[Any]]:
    q = _top_eigenvector(_davenport(_rotation(A)))
    moved = [sum(A[4 * i + k] * mean[k] for k in range(3)) + A[4 * i + 3] for i in range(3)]
    return moved, _multiply(q, quat)


def _adjoint(
    A: list[Any], mean: list[Any], quat: list[Any], grad_mean: list[Any], grad_quat: list[Any]
) -> tuple[list[Any], list[Any], list[Any]]:
    B = _davenport(_rotation(A))
    q = _top_eigenvector(B)
    # Left and right multiplication by a quaternion are matrices whose transposes conjugate it.
    grad_quat_in = _multiply(_conjugate(q), grad_quat)
    grad_q = _multiply(grad_quat, _conjugate(quat))
    y = _project_and_solve(B, q, grad_q)
    grad_rotation = _davenport_adjoint([[y[i] * q[j] for j in range(4)] for i in range(4)])
    grad_A = []
    for i in range(3):
        grad_A += [grad_rotation[3 * i + k] + grad_mean[i] * mean[k] for k in range(3)]
        grad_A.append(grad_mean[i])
    grad_mean_in = [sum(A[4 * i + k] * grad_mean[i] for i in range(3)) for k in range(3)]
    return grad_A, grad_mean_in, grad_quat_in


def _tangent(
    A: list[Any], mean: list[Any], quat: list[Any], dA: list[Any], dmean: list[Any],
    dquat: list[Any],
) -> tuple[list[Any], list[Any]]:  # fmt: skip
    B = _davenport(_rotation(A))
    q = _top_eigenvector(B)
    dB = _davenport(_rotation(dA), one=0)
    at = lambda i, j: dB[(i, j) if i <= j else (j, i)]
    dq = _project_and_solve(B, q, [sum(at(i, k) * q[k] for k in range(4)) for i in range(4)])
    moved = []
    for i in range(3):
        along = sum(dA[4 * i + k] * mean[k] + A[4 * i + k] * dmean[k] for k in range(3))
        moved.append(along + dA[4 * i + 3])
    turned = [a + b for a, b in zip(_multiply(dq, quat), _multiply(q, dquat), strict=True)]
    return moved, turned


def _rotation(A: list[Any]) -> list[Any]:
    return [A[4 * i + k] for i in range(3) for k in range(3)]


# --- torch ---


class _ApplyLbs(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, A: Tensor, means: Tensor, quats: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(A, means, quats)
        ctx.save_for_forward(A, means, quats)
        if len(means) == 0:
            return means.clone(), quats.clone()
        return launch(_forward, A, means, quats)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad_means: Tensor, grad_quats: Tensor) -> tuple[Tensor, ...]:
        A, means, quats = ctx.saved_tensors
        if len(means) == 0:
            return torch.zeros_like(A), torch.zeros_like(means), torch.zeros_like(quats)
        return launch(_adjoint, A, means, quats, grad_means, grad_quats)

    @staticmethod
    def jvp(ctx: FunctionCtx, dA: Tensor, dmeans: Tensor, dquats: Tensor) -> tuple[Tensor, Tensor]:
        A, means, quats = ctx.saved_tensors
        if len(means) == 0:
            return dmeans.clone(), dquats.clone()
        return launch(_tangent, A, means, quats, dA, dmeans, dquats)
