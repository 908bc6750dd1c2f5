"""The outer boundary of an alpha shape: the surface of Sec. 4.3 as the paper prints it.

A ball of radius α that holds no point rolls around the points from outside. It cannot pass a
triangle of the Delaunay triangulation through whose corners an empty ball of at most α fits
(Edelsbrunner, Kirkpatrick and Seidel, "On the shape of a set of points in the plane", 1983):

1. μ(triangle) = its own circumradius, if the smallest ball through its corners is empty;
                 else the smaller circumradius of the two tetrahedra at it
2. boundary    = triangles with μ ≤ α between tetrahedra that are reached from outside, through
                 triangles with μ > α, and tetrahedra that are not
"""

from __future__ import annotations

import numpy as np

from gva_mi.avatar.offset_surface import SurfaceMesh

FACETS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite to each corner


def alpha_shape(points: np.ndarray, alpha: float, smoothing: int) -> SurfaceMesh:
    """Return the outer boundary of the alpha shape of points (N, 3), smoothed; lengths in metres.

    It has no triangles that are outside on both sides. Where more than two meet at an edge, some
    are left out: it is a manifold, but not closed there.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import Delaunay

    cells = Delaunay(points)
    corners, count = cells.simplices.astype(np.int64), len(cells.simplices)
    over = np.where(cells.neighbors < 0, count, cells.neighbors)  # number `count`: all outside
    closed = _smallest_empty_balls(points, corners, over) <= alpha
    cell = np.broadcast_to(np.arange(count)[:, None], over.shape)
    passed = cell[~closed], over[~closed]
    graph = coo_array((np.ones(len(passed[0]), bool), passed), (count + 1, count + 1))
    part = connected_components(graph, directed=False)[1]
    outside = part == part[count]
    boundary = ~outside[cell] & outside[over]
    a, b, c = (points[corners[:, 1:]] - points[corners[:, :1]]).transpose(1, 0, 2)
    mirrored = (a * np.cross(b, c)).sum(1) < 0
    facets = np.where(mirrored[:, None, None], FACETS[:, ::-1], FACETS)
    faces = np.take_along_axis(corners[:, None], facets, 2)[boundary]
    meshes = SurfaceMesh(points, faces).part(np.ones(len(faces), bool)).meshlab()
    meshes.meshing_repair_non_manifold_edges()  # curvature needs a manifold
    meshes.meshing_repair_non_manifold_vertices()
    if smoothing:
        meshes.apply_coord_laplacian_smoothing(stepsmoothnum=smoothing)
    mesh = meshes.current_mesh()
    found = SurfaceMesh(np.array(mesh.vertex_matrix()), mesh.face_matrix().astype(np.int64))
    return found.part(np.ones(len(found.faces), bool))  # without vertices that no face is left of


def _smallest_empty_balls(points: np.ndarray, corners: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return μ of eq. 1 of the four triangles of tetrahedra ``corners`` (C, 4), (C, 4) metres.

    ``over`` (C, 4) is the tetrahedron beyond the triangle opposite to each corner; C: none.
    """
    triangles = corners[:, FACETS]
    own, centre = _circles(points[triangles])
    holds_apex = np.linalg.norm(points[corners] - centre, axis=2) < own
    _, which = np.unique(np.sort(triangles.reshape(-1, 3), axis=1), axis=0, return_inverse=True)
    which = which.reshape(own.shape)  # a number for each triangle, seen from either side
    empty = np.bincount(which.ravel(), holds_apex.ravel())[which] == 0
    of_cell = np.append(_spheres(points[corners]), np.inf)
    return np.where(empty, own, np.minimum(of_cell[:-1, None], of_cell[over]))


def _spheres(x: np.ndarray) -> np.ndarray:
    """Return the radii of the spheres through tetrahedra (C, 4, 3), (C,); flat ones: infinite."""
    a, b, c = (x[:, 1:] - x[:, :1]).transpose(1, 0, 2)
    square = lambda v: (v**2).sum(1, keepdims=True)
    across = square(a) * np.cross(b, c) + square(b) * np.cross(c, a) + square(c) * np.cross(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        radii = np.linalg.norm(across, axis=1) / np.abs(2 * (a * np.cross(b, c)).sum(1))
    return np.nan_to_num(radii, nan=np.inf)


def _circles(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radius and centre of circles through triangles (..., 3, 3); flat ones: infinite."""
    a, b = x[..., 1, :] - x[..., 0, :], x[..., 2, :] - x[..., 0, :]
    normal = np.cross(a, b)
    square = lambda v: (v**2).sum(-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.cross(square(a) * b - square(b) * a, normal) / (2 * square(normal))
    radius = np.linalg.norm(shift, axis=-1)
    return np.nan_to_num(radius, nan=np.inf), x[..., 0, :] + np.nan_to_num(shift)
