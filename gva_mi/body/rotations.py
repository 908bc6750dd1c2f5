"""Rotations as numpy arrays: axis-angle to matrices and back, composition, shortest rotations.

All are float64. Torch tensors, with gradients: :mod:`gva_mi.body.so3`.
"""

from __future__ import annotations

import numpy as np
import torch

from gva_mi.body import so3


def to_matrices(rotvecs: np.ndarray) -> np.ndarray:
    """Convert axis-angle vectors (..., 3), radians, to rotation matrices (..., 3, 3)."""
    return so3.to_matrix(torch.from_numpy(np.array(rotvecs, np.float64))).numpy()


def to_rotvecs(matrices: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to axis-angle vectors (..., 3)."""
    return so3.to_rotvec(torch.from_numpy(np.array(matrices, np.float64))).numpy()


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) that rotate by angles (...), radians, about one axis."""
    return to_matrices(np.asarray(angle)[..., None] * np.eye(3)[axis])


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) nearest to matrices that lost digits."""
    U, _, Vt = torch.linalg.svd(torch.from_numpy(np.array(matrices, np.float64)))
    U[..., -1] *= (torch.det(U) * torch.det(Vt)).sign()[..., None]
    return (U @ Vt).numpy()


def composed(first: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Return the rotation R(first) R(then), axis-angle (n, 3); each is (3,) or (n, 3)."""
    a, b = (torch.from_numpy(np.array(x, np.float64)) for x in np.broadcast_arrays(first, then))
    return so3.compose(a, b).numpy()


def shortest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the shortest rotations, axis-angle (..., 3), from directions a to b (..., 3)."""
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(-1, keepdims=True))
    return axis * (angle / np.maximum(sine, 1e-300))
