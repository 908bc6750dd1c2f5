"""A closed surface around a person's Gaussians: an offset surface, shrunk back.

Around every point lies a ball of radius α. Balls of points less than 2 α apart overlap, across
holes and along seams; the outer boundary of their union is

    1. S_α = {x : d(x) = α},   d(x) the distance from the nearest point

which is smoothed and moved back by α along its normals. What is closer than 2 α to itself, such as
thighs, is closed as by an alpha shape; unlike one, S_α is always watertight, like the paper's
"spherical shell" around the outermost Gaussians.

d is exact on a grid with cells of α, as far as S_α can pass; ``marching_cubes`` finds S_α to a
fraction of a millimetre. Points of the shrunk rest body are added, so that no hole lets S_α inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.mesh.surface import vertex_normals

if TYPE_CHECKING:
    from pymeshlab import MeshSet

REACH = 3  # cells around a point in which S_α, and the far corners of its cells, can lie
LONE = 10  # smallest piece of the person, in surfaces of one ball


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles in the rest pose."""

    vertices: np.ndarray  # (V, 3) float64, metres
    faces: np.ndarray  # (F, 3) int64, counter-clockwise seen from outside

    def areas(self) -> np.ndarray:
        """Return the areas of the faces, (F,) m²."""
        return np.linalg.norm(self._crosses(), axis=1) / 2

    def normals(self) -> np.ndarray:
        """Return the unit normals of the vertices, (V, 3)."""
        x, f = torch.from_numpy(self.vertices), torch.from_numpy(self.faces)
        return vertex_normals(x, f).numpy()

    def volumes(self) -> np.ndarray:
        """Return each face's part of the enclosed volume, (F,) m³."""
        return (self._crosses() * self.vertices[self.faces[:, 0]]).sum(1) / 6

    def part(self, kept: np.ndarray) -> SurfaceMesh:
        """Keep some of the faces (F,) bool, and the vertices that they use."""
        used, renumbered = np.unique(self.faces[kept], return_inverse=True)
        return SurfaceMesh(self.vertices[used], renumbered.reshape(-1, 3))

    def meshlab(self) -> MeshSet:
        """Return the surface in pymeshlab's memory, to apply its filters to."""
        import pymeshlab

        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(self.vertices, self.faces))
        return meshes

    def _crosses(self) -> np.ndarray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)


def offset_surface(
    points: np.ndarray, inner: SurfaceMesh, alpha: float, smoothing: int
) -> SurfaceMesh:
    """Wrap points (N, 3) in a closed and smooth surface that does not sink beneath the ``inner``
    one.

    ``alpha`` is α, metres; ``smoothing`` counts steps of Taubin's filter.
    """
    between = inner.vertices[inner.faces].mean(1)
    shell = _large_pieces(
        _union_of_balls(np.vstack([points, inner.vertices, between]), alpha), alpha
    )
    if smoothing:
        meshes = shell.meshlab()
        meshes.apply_coord_taubin_smoothing(stepsmoothnum=smoothing)
        shell = SurfaceMesh(np.array(meshes.current_mesh().vertex_matrix()), shell.faces)
    return SurfaceMesh(shell.vertices - alpha * shell.normals(), shell.faces)


def _union_of_balls(points: np.ndarray, alpha: float) -> SurfaceMesh:
    """Return S_α of points (N, 3)."""
    from scipy.ndimage import maximum_filter1d
    from scipy.spatial import cKDTree
    from skimage.measure import marching_cubes

    low = points.min(0) - (REACH + 1) * alpha
    cell = np.rint((points - low) / alpha).astype(int)
    near = np.zeros(cell.max(0) + REACH + 2, np.uint8)
    near[tuple(cell.T)] = 1
    for axis in range(3):
        near = maximum_filter1d(near, 2 * REACH + 1, axis=axis, mode="constant")
    corners = np.argwhere(near)
    distance = np.full(near.shape, 2 * alpha, np.float32)
    found, _ = cKDTree(points).query(corners * alpha + low, workers=-1)
    distance[tuple(corners.T)] = found
    vertices, faces, _, _ = marching_cubes(distance, alpha)
    return SurfaceMesh(vertices.astype(float) * alpha + low, faces.astype(np.int64))


def _large_pieces(surface: SurfaceMesh, alpha: float) -> SurfaceMesh:
    """Drop the pieces around few points, and those that face inwards."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    V, faces = len(surface.vertices), surface.faces
    edges = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_array((np.ones(2 * len(faces), dtype=bool), edges), (V, V))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    area, volume = (np.bincount(piece, x) for x in (surface.areas(), surface.volumes()))
    large = area >= min(area.max(), LONE * 4 * np.pi * alpha**2)
    return surface.part((large & (volume > 0))[piece])
