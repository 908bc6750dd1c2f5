"""Fly-away strands of hair: thin ribbons that leave the surface of the hair and sink a little.

A picture shows them as a soft, irregular edge around the head, which masks have to follow.
"""

from __future__ import annotations

import numpy as np

from gva_mi.synthetic.clothes.level_sets import vertex_normals

COUNT = 700  # of a head
LENGTH = (0.008, 0.045)  # m
WIDTH = 0.0007  # m at the root, for a few hairs that lie together; they end in a point
SEGMENTS = 3
SINK = 6.0  # 1/m: a strand of length s sinks by SINK · s²


def strands(
    vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw strands on the hair, triangles ``faces`` (F, 3) of a surface with ``vertices`` (N, 3).

    Returns:
        their vertices (n, 3), metres, triangles (m, 3) of these, and the vertex (n,) of the
        surface that each of them follows.
    """
    used = np.unique(faces)
    roots = used[rng.integers(len(used), size=COUNT)]
    normals = vertex_normals(vertices.astype(np.float64), faces)[roots]
    unit = lambda v: v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9)
    along = unit(normals + 0.9 * unit(rng.normal(size=(COUNT, 3))))
    across = unit(np.cross(along, rng.normal(size=(COUNT, 3))))
    share = np.linspace(0, 1, SEGMENTS + 1)[:, None, None]
    s = share * rng.uniform(*LENGTH, (COUNT, 1))
    middle = vertices[roots] + s * along - SINK * s**2 * [0, 1, 0]
    aside = 0.5 * WIDTH * (1 - 0.9 * share) * across
    points = np.stack([middle - aside, middle + aside], axis=1)  # (SEGMENTS + 1, 2, COUNT, 3)
    points = points.transpose(2, 0, 1, 3).reshape(-1, 3)
    quads = 2 * np.arange(SEGMENTS)[:, None, None] + [[0, 1, 3], [0, 3, 2]]
    per_strand = 2 * (SEGMENTS + 1)
    triangles = np.arange(COUNT)[:, None, None] * per_strand + quads.reshape(-1, 3)
    return points, triangles.reshape(-1, 3), np.repeat(roots, per_strand)
