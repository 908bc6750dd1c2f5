"""Rotations as numpy arrays: axis-angle to matrices and back, composition, shortest rotations.

All are float64. Torch tensors are composed, with gradients, by :mod:`gva_mi.body.so3`.
"""

from __future__ import annotations

import numpy as np
import roma
import torch


def to_matrices(rotvecs: np.ndarray) -> np.ndarray:
    """Convert axis-angle vectors (..., 3), radians, to rotation matrices (..., 3, 3)."""
    return roma.rotvec_to_rotmat(torch.from_numpy(np.array(rotvecs, np.float64))).numpy()


def to_rotvecs(matrices: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to axis-angle vectors (..., 3)."""
    return roma.rotmat_to_rotvec(torch.from_numpy(np.array(matrices, np.float64))).numpy()


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) that rotate by angles (...), radians, about one axis."""
    return to_matrices(np.asarray(angle)[..., None] * np.eye(3)[axis])


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) nearest to matrices that lost digits."""
    return roma.special_procrustes(
        torch.from_numpy(np.array(matrices, np.float64)), method="svd"
    ).numpy()


def composed(first: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Return the rotation R(first) R(then), axis-angle (n, 3); each is (3,) or (n, 3)."""
    a, b = np.broadcast_arrays(first, then)
    vectors = [torch.from_numpy(np.array(x, np.float64)) for x in (a, b)]
    return roma.rotvec_composition(vectors).numpy()


def shortest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the shortest rotations, axis-angle (n, 3), from directions a (n, 3) to b (n, 3)."""
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(1, keepdims=True))
    return axis * (angle / np.maximum(sine, 1e-300))
