"""Normals of a subject's surface, and the smooth step that shapes are blended with."""

from __future__ import annotations

import numpy as np


def smoothstep(x: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """Smooth step: 0 below ``lo``, 1 above ``hi``."""
    t = np.clip((x - lo) / (hi - lo), 0, 1)
    return t * t * (3 - 2 * t)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return area-weighted unit vertex normals (V, 3) in float64.

    ``gva_mi.mesh.surface`` sums in another order; synthetic subjects depend on this rounding.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    count = len(vertices)
    sums = [sum(np.bincount(faces[:, k], cross[:, i], count) for k in range(3)) for i in range(3)]
    normals = np.stack(sums, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
