"""Rotation matrices of arrays and of tensors, and whether rotations are the same."""

import numpy as np

from gva_mi.body.rotations import to_matrices


def matrices(rotvecs):
    return to_matrices(np.asarray(rotvecs))


def same(found, wanted, tolerance=2e-6):
    """Equal as rotations: an axis-angle is known but for whole turns."""
    return np.abs(matrices(found) - matrices(wanted)).max() < tolerance
