"""Gaussians that stretch with the skin: formulas and adjoint, on the numbers of one Gaussian.

Between two joints that turn differently, skin is pulled apart. The LBS transform A moves a point;
the derivative of x' = A(x) x moves its surroundings. Beside A_rot it has a part E, by which A
itself changes from place to place (:mod:`gva_mi.avatar.lbs_transforms`):

    1. J  = A_rot + β E,   β = (1 + |E|² / LARGEST²)^(-1/2)       no more than cloth would bear
    2. F  = J M S,   Σ' = F Fᵀ                                    M, S: the Gaussian at rest
    3. μ' = A_rot μ + A_trans                                     Eq. 5

Eq. 6 of the paper turns a Gaussian by A_rot and keeps its size: where a wide step spreads a skirt,
Gaussians come apart and show what is behind them. With eq. 2 they grow and shear as the cloth
does. A rigid motion has no E and moves Gaussians exactly.

The adjoint, for gradients g of μ' and G of Σ' (symmetric):

    4. grad_F = 2 G F,   grad_S, grad_M, grad_J by F = J M S
    5. grad_E = β grad_J - (β³ / LARGEST²) (grad_J : E) E
    6. grad_A = [grad_J + g μᵀ | g],   grad_μ = A_rotᵀ g
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from gva_mi.jit.rowwise import Lane
from gva_mi.splat.kernels.ellipse import Rotation

LARGEST = 3.0  # of |J - A_rot|: cloth that is pulled to four times its length would tear
AXES = range(3)
PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]  # of a covariance's six numbers


def _bound(E: Lane) -> Any:  # noqa: ANN401
    """Return β of eq. 1."""
    return 1 / dr.sqrt(1 + _dot(E, E) / LARGEST**2)


def _gradient(A: Lane, E: Lane, beta: Any) -> Lane:  # noqa: ANN401
    """Return J of eq. 1."""
    return [A[4 * i + c] + beta * E[3 * i + c] for i in AXES for c in AXES]


def _times(X: Lane, Y: Lane) -> Lane:
    """Multiply two matrices."""
    return [sum(X[3 * i + k] * Y[3 * k + j] for k in AXES) for i in AXES for j in AXES]


def _transposed(X: Lane) -> Lane:
    return [X[3 * j + i] for i in AXES for j in AXES]


def _scaled(X: Lane, scale: Lane) -> Lane:
    """Multiply a matrix by a diagonal one."""
    return [X[3 * i + j] * scale[j] for i in AXES for j in AXES]


def _dot(X: Lane, Y: Lane) -> Any:  # noqa: ANN401
    return sum(a * b for a, b in zip(X, Y, strict=True))


def forward(A: Lane, E: Lane, mean: Lane, quat: Lane, scale: Lane) -> tuple[Lane, Lane]:
    """Evaluate eq. 1 to 3: μ', and the six numbers of Σ' (xx, xy, xz, yy, yz, zz)."""
    JM = _times(_gradient(A, E, _bound(E)), Rotation.of(quat).M)
    F = _scaled(JM, scale)
    moved = [sum(A[4 * i + k] * mean[k] for k in AXES) + A[4 * i + 3] for i in AXES]
    return moved, [sum(F[3 * i + k] * F[3 * j + k] for k in AXES) for i, j in PAIRS]


def adjoint(
    A: Lane, E: Lane, mean: Lane, quat: Lane, scale: Lane, g: Lane, G: Lane
) -> tuple[Lane, Lane, Lane, Lane, Lane]:
    """Evaluate eq. 4 to 6."""
    rotation, beta = Rotation.of(quat), _bound(E)
    J, M = _gradient(A, E, beta), rotation.M
    JM = _times(J, M)
    xx, xy, xz, yy, yz, zz = G  # a number beside the diagonal stands for two of a matrix
    twice = [2 * xx, xy, xz, xy, 2 * yy, yz, xz, yz, 2 * zz]
    grad_F = _times(twice, _scaled(JM, scale))
    grad_scale = [sum(grad_F[3 * i + j] * JM[3 * i + j] for i in AXES) for j in AXES]
    grad_JM = _scaled(grad_F, scale)
    grad_J, grad_M = _times(grad_JM, _transposed(M)), _times(_transposed(J), grad_JM)
    along = beta * beta * beta / LARGEST**2 * _dot(grad_J, E)
    grad_E = [beta * a - along * b for a, b in zip(grad_J, E, strict=True)]
    grad_A = []
    for i in AXES:
        grad_A += [grad_J[3 * i + k] + g[i] * mean[k] for k in AXES] + [g[i]]
    grad_mean = [sum(A[4 * i + k] * g[i] for i in AXES) for k in AXES]
    return grad_A, grad_E, grad_mean, rotation.adjoint(grad_M), grad_scale
