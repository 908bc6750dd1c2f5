"""The order of points along a Morton curve, on which neighbours in space are mostly neighbours."""

from __future__ import annotations

import numpy as np

BITS = 10  # of each axis


def morton_order(points: np.ndarray) -> np.ndarray:
    """Return the order (N,) of points (N, 3) along a Morton curve through their bounding box."""
    low, high = points.min(0, initial=np.inf), points.max(0, initial=-np.inf)
    with np.errstate(invalid="ignore"):
        cell = (points - low) / np.maximum(high - low, 1e-12) * ((1 << BITS) - 1)
        cell = cell.astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
