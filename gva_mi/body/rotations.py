"""Rotations as numpy arrays: axis-angle to matrices and back, composition, shortest rotations.

All are float64. :mod:`gva_mi.body.so3` has the same for torch tensors, with gradients, and names
the sources.
"""

from __future__ import annotations

import numpy as np
import torch

from gva_mi.body import so3


def to_matrices(rotvecs: np.ndarray) -> np.ndarray:
    """Convert axis-angle vectors (..., 3), radians, to rotation matrices (..., 3, 3).

    Example:
        >>> to_matrices(np.array([np.pi, 0, 0])).diagonal()
        array([ 1., -1., -1.])
    """
    return so3.to_matrix(torch.from_numpy(np.array(rotvecs, np.float64))).numpy()


def to_rotvecs(matrices: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to axis-angle vectors (..., 3), radians.

    Example:
        >>> to_rotvecs(to_matrices(np.array([0.1, -0.2, 0.3]))).round(6)
        array([ 0.1, -0.2,  0.3])
    """
    return so3.to_rotvec(torch.from_numpy(np.array(matrices, np.float64))).numpy()


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) that rotate by angles (...), radians, about axis 0, 1 or 2.

    Example:
        A quarter turn about z takes x to y.

        >>> (about(2, np.pi / 2) @ [1, 0, 0]).round(6) + 0
        array([0., 1., 0.])
    """
    return to_matrices(np.asarray(angle)[..., None] * np.eye(3)[axis])


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) nearest to matrices that lost digits.

    Example:
        >>> rounded = about(0, 0.3).round(2)
        >>> R = nearest_rotations(rounded)
        >>> bool(np.allclose(R @ R.T, np.eye(3)))
        True
    """
    return so3.nearest(torch.from_numpy(np.array(matrices, np.float64))).numpy()


def composed(first: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Return the rotation R(first) R(then), axis-angle (n, 3); each is (3,) or (n, 3).

    Example:
        >>> composed(np.array([0.5, 0, 0]), np.array([[0.25, 0, 0], [-0.5, 0, 0]])).round(6) + 0
        array([[0.75, 0.  , 0.  ],
               [0.  , 0.  , 0.  ]])
    """
    a, b = (torch.from_numpy(np.array(x, np.float64)) for x in np.broadcast_arrays(first, then))
    return so3.compose(a, b).numpy()


def shortest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the shortest rotations, axis-angle (..., 3), from directions a to b (..., 3).

    The rotation is about a × b. Directions of any length; opposite ones give no rotation.

    Example:
        >>> shortest(np.array([1.0, 0, 0]), np.array([0.0, 2, 0])).round(4)
        array([0.    , 0.    , 1.5708])
    """
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(-1, keepdims=True))
    return axis * (angle / np.maximum(sine, 1e-300))
