"""Points on a surface: dart throwing with a given density, and the curvature of the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.avatar.offset_surface import SurfaceMesh

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

AT_ONCE = 2048  # darts whose neighbours are queried together


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface, no two too close."""

    points: np.ndarray  # (N, 3) metres
    normals: np.ndarray  # (N, 3)
    spacing: np.ndarray  # (N,) metres, mean distance to the nearest others


def resample(
    surface: SurfaceMesh, count: int, density: np.ndarray, rng: np.random.Generator
) -> SurfacePoints:
    """Draw about ``count`` points on a surface, with a density (V,) given at its vertices.

    Many candidates are drawn with that density. In random order, each one that is left removes all
    others within its radius, ~ density^(-1/2): darts of variable radius, corrected until the count
    fits.
    """
    from scipy.spatial import cKDTree

    v, f = surface.vertices, surface.faces
    mass = surface.areas() * density[f].mean(1)
    oversampling = 6
    chosen = rng.choice(len(f), oversampling * count, p=mass / mass.sum())
    barycentric = rng.dirichlet([1, 1, 1], len(chosen))[:, :, None]
    on_faces = lambda x: (x[f[chosen]] * barycentric).sum(1)
    points, tree = on_faces(v), cKDTree(on_faces(v))
    # The densest packing has count · r^2 · sqrt(3) / 2 = area; random darts reach 2/3 of that r.
    radius = 0.665 * np.sqrt(2 / 3**0.5 * mass.sum() / count / on_faces(density[:, None])[:, 0])
    for _ in range(3):
        kept = _throw_darts(tree, points, radius)
        if abs(len(kept) / count - 1) < 0.02:
            break
        radius *= np.sqrt(len(kept) / count)
    points, normals = points[kept], on_faces(surface.normals())[kept]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return SurfacePoints(points, normals, mean_distance(points, 3))


def mean_distance(points: np.ndarray, neighbours: int) -> np.ndarray:
    """Return the mean distance of each point (N, 3) to its nearest neighbours, (N,)."""
    from scipy.spatial import cKDTree

    return cKDTree(points).query(points, k=neighbours + 1, workers=-1)[0][:, 1:].mean(1)


def curvature(surface: SurfaceMesh) -> np.ndarray:
    """Return the root mean square of the principal curvatures, (V,), scaled to [0, 1]."""
    meshes = surface.meshlab()
    meshes.compute_scalar_by_discrete_curvature_per_vertex(curvaturetype="RMS Curvature")
    curvature = np.nan_to_num(meshes.current_mesh().vertex_scalar_array(), posinf=0, neginf=0)
    largest = np.percentile(curvature, 95)
    return np.clip(curvature / largest, 0, 1) if largest > 0 else np.zeros(len(curvature))


def _throw_darts(tree: cKDTree, points: np.ndarray, radius: np.ndarray) -> list[int]:
    """Return indices of points that remain if each removes all later ones within its radius."""
    alive = np.ones(len(points), dtype=bool)
    kept = []
    for first in range(0, len(points), AT_ONCE):
        some = first + np.flatnonzero(alive[first : first + AT_ONCE])  # most are gone by now
        around = tree.query_ball_point(points[some], radius[some], return_sorted=False)
        for i, close in zip(some, around, strict=True):
            if alive[i]:
                kept.append(i)
                alive[close] = False
    return kept
