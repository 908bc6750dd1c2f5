"""Closed surfaces around a body, as zero level sets of fields on a voxel grid.

A field f is negative inside and positive outside, in metres, and close to a signed distance near
the surface. Its zero level set is closed and never intersects itself, so silhouettes and normals
are well defined. Fields are made from the distance to the body's surface (:class:`BodySurface`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EXACT_BAND = 0.05  # m from the body; chosen: most clothes lie closer
SMALLEST_COMPONENT = 400  # faces; chosen: crumbs are smaller, garments larger


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


@dataclass(frozen=True)
class RestMesh:
    """A closed triangle mesh in the rest pose."""

    vertices: np.ndarray  # (V, 3) metres
    faces: np.ndarray  # (F, 3) counter-clockwise seen from outside
    shade: np.ndarray  # (V,) in [0, 1], fraction of light received; below 1 inside openings


@dataclass(frozen=True)
class VoxelGrid:
    """A regular grid; ``x``, ``y``, ``z`` are its coordinates in metres and broadcast."""

    lo: np.ndarray  # (3,) metres
    cell: float  # metres
    shape: tuple[int, int, int]

    @staticmethod
    def around(lo: np.ndarray, hi: np.ndarray, cell: float) -> VoxelGrid:
        """Return the grid of the box between corners ``lo`` and ``hi``, (3,) metres."""
        shape = np.ceil((np.asarray(hi) - lo) / cell).astype(int) + 1
        return VoxelGrid(np.asarray(lo, dtype=np.float64), cell, tuple(int(n) for n in shape))

    def _axis(self, k: int) -> np.ndarray:
        values = (self.lo[k] + self.cell * np.arange(self.shape[k])).astype(np.float32)
        return values.reshape([-1 if i == k else 1 for i in range(3)])

    x = property(lambda self: self._axis(0))
    y = property(lambda self: self._axis(1))
    z = property(lambda self: self._axis(2))


def smax(a: np.ndarray, b: np.ndarray, k: float = 0.012) -> np.ndarray:
    """Smooth maximum: round the edge between two fields over about ``k`` metres."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.maximum(a, b) + h * h * (k / 4)


def smin(a: np.ndarray, b: np.ndarray, k: float = 0.012) -> np.ndarray:
    """Smooth minimum."""
    return -smax(-a, -b, k)


class BodySurface:
    """A body's rest surface as oriented points, which give smooth signed distances.

    Points (N, 3), metres, are about 7 mm apart; their normals point outwards.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> None:
        from scipy.spatial import cKDTree

        corners, directions = vertices[faces], normals[faces]
        # Vertices; for each face its centre, three points around it and two edge midpoints.
        weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [3, 3, 0], [0, 3, 3]])
        weights = weights / weights.sum(1, keepdims=True)
        self.points = np.concatenate([vertices, *np.einsum("wk,fkc->wfc", weights, corners)])
        normals = np.concatenate([normals, *np.einsum("wk,fkc->wfc", weights, directions)])
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self.tree = cKDTree(self.points)

    def distance(self, x: np.ndarray, smooth: float = 0.012) -> np.ndarray:
        """Return signed distances (N,) of points (N, 3) to the mean of nearby tangent planes."""
        distance, index = self.tree.query(x, k=6, workers=-1)
        weight = np.exp((distance[:, :1] ** 2 - distance**2) / smooth**2)
        height = np.einsum("nkc,nkc->nk", x[:, None] - self.points[index], self.normals[index])
        plane = (weight * height).sum(1) / weight.sum(1)
        return np.where(np.abs(plane) > distance[:, 0], np.sign(plane) * distance[:, 0], plane)

    def sample(self, grid: VoxelGrid, band: float = EXACT_BAND) -> np.ndarray:
        """Return signed distances on a grid: exact within ``band``, counted in cells beyond it."""
        from scipy.ndimage import distance_transform_edt

        cells = np.round((self.points - grid.lo) / grid.cell).astype(int)
        cells = cells[((cells >= 0) & (cells < grid.shape)).all(1)]
        empty = np.ones(grid.shape, dtype=bool)
        empty[tuple(cells.T)] = False
        coarse = distance_transform_edt(empty).astype(np.float32) * grid.cell
        near = coarse < band
        values = coarse
        values[near] = self.distance(np.argwhere(near) * grid.cell + grid.lo)
        # Cells farther away have the sign of the nearest of these: some lie deep in the trunk.
        nearest = distance_transform_edt(~near, return_distances=False, return_indices=True)
        values[~near] *= np.sign(values[tuple(nearest[:, ~near])])
        return values


def surface_of(grid: VoxelGrid, field: np.ndarray, uncut: np.ndarray | None = None) -> RestMesh:
    """Extract the zero level set of a field, negative inside, metres, by marching cubes.

    ``uncut`` is the field before openings were cut: vertices deep inside it are shaded.
    """
    import trimesh
    from scipy.ndimage import map_coordinates
    from skimage.measure import marching_cubes

    field = np.pad(field, 1, constant_values=1.0)  # closed at the block's border
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    parts = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(faces)))
    parts = [p for p in parts if len(p) > SMALLEST_COMPONENT]
    used, faces = np.unique(faces[np.sort(np.concatenate(parts))], return_inverse=True)
    vertices = vertices[used].astype(np.float64) - 1
    shade = np.ones(len(vertices), dtype=np.float32)
    if uncut is not None:
        depth = map_coordinates(uncut, vertices.T, order=1, mode="nearest")
        shade = 1 - 0.65 * smoothstep(-depth, 0.006, 0.014) - 0.2 * smoothstep(-depth, 0.014, 0.04)
    vertices = (vertices * grid.cell + grid.lo).astype(np.float32)
    return RestMesh(vertices, faces.reshape(-1, 3), shade.astype(np.float32))
