"""A closed surface around a person's Gaussians, and points on it.

The offset surface. Around every point lies a ball of radius α. Balls of points that are less than
2 α apart overlap, across holes and along seams; the outer boundary of their union is

    1. S_α = {x : d(x) = α},   d(x) the distance from the nearest point

which is smoothed and moved back by α along its normals. Gaps narrower than 2 α, as between thighs,
are closed as by an alpha shape. Unlike an alpha shape, S_α is always watertight, like the paper's
"spherical shell" around the outermost Gaussians. d is exact on a grid with cells of α, as far as
S_α can pass; ``marching_cubes`` finds S_α to a fraction of a millimetre. Points of the shrunk rest
body are added, so that S_α does not enter through holes.

The alpha shape of Sec. 4.3, as the paper prints it. A ball of radius α that holds no point rolls
around the points from outside. It cannot pass a triangle of the Delaunay triangulation through
whose corners an empty ball of at most α fits (Edelsbrunner, Kirkpatrick and Seidel, "On the shape
of a set of points in the plane", 1983):

    2. μ(triangle) = its own circumradius, if the smallest ball through its corners is empty;
                     else the smaller circumradius of the two tetrahedra at it
    3. boundary    = triangles with μ ≤ α between tetrahedra that are reached from outside, through
                     triangles with μ > α, and tetrahedra that are not

Limbs are spread before. At rest, thighs, calves and trouser legs are a few centimetres apart, and
arms are level: a surface that closes holes of that width would also join the legs, and arms and
trunk, by webs that hang from both. So points are moved by linear blend skinning, and the surface is
moved back:

    4. x = A(w) x_rest,        A(w) = Σ_j w_j T_j
       T_j: legs turn outward, arms up, by SPREAD_ANGLE
    5. v_rest = A(w_v)⁻¹ v,    w_v: mean weights of the points around v, by 1 / distance²

A skirt is stretched between the legs, and covers them both. Fingers, which would be joined too, are
bare skin that the body model knows best: the surface takes them from the rest body.

Sources: marching cubes as in scikit-image (Lewiner et al., 2003); Taubin's filter (1995); points on
the surface by dart throwing (Cline et al., "Dart throwing on surfaces", 2009).
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.avatar.rig import Rig, inverse
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS
from gva_mi.body.skinning import finger_weights
from gva_mi.mesh.surface import vertex_normals

if TYPE_CHECKING:
    from pymeshlab import MeshSet
    from scipy.spatial import cKDTree


BALL_CELLS = 3  # cells around a point in which S_α, and the far corners of its cells, can lie
# The smallest piece of S_α that is kept, in surfaces of one ball. Chosen: a few floaters are fewer.
SMALLEST_PIECE = 10
OVERSAMPLING = 6  # candidates per wanted point; chosen: enough for the densest random packing
DART_RADIUS = 0.665  # reached by random darts, in radii of the densest packing; see resample()
COUNT_TOLERANCE = 0.02  # of the number of points, as a share; chosen: options say a few percent


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles in the rest pose.

    Example:
        A tetrahedron.

        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> mesh = SurfaceMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
        >>> mesh.areas().round(3), mesh.volumes().sum().round(3), mesh.open_edges()
        (array([0.5  , 0.5  , 0.5  , 0.866]), np.float64(0.167), 0)
    """

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

    def open_edges(self) -> int:
        """Count the edges that belong to a single face: 0 if the surface is closed."""
        ends = np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        return int((np.unique(ends, axis=0, return_counts=True)[1] == 1).sum())

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
    """Wrap points (N, 3) in a closed, smooth surface that does not sink beneath ``inner``.

    ``alpha`` is α, metres; ``smoothing`` counts steps of Taubin's filter.

    Example:
        Around a ball of 20 cm and points 10 cm above it.

        >>> from skimage.measure import marching_cubes
        >>> at = np.mgrid[-6:7, -6:7, -6:7] / 20
        >>> vertices, faces, _, _ = marching_cubes(np.linalg.norm(at, axis=0), 0.2)
        >>> ball = SurfaceMesh((vertices - 6) / 20, faces.astype(np.int64))
        >>> above = ball.vertices * 1.5
        >>> wrapped = offset_surface(above, ball, alpha=0.05, smoothing=10)
        >>> print(f"{np.linalg.norm(wrapped.vertices, axis=1).mean():.2f} m")
        0.29 m
    """
    between = inner.vertices[inner.faces].mean(1)
    balls = np.vstack([points, inner.vertices, between])
    shell = _large_pieces(_union_of_balls(balls, alpha), alpha)
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

    low = points.min(0) - (BALL_CELLS + 1) * alpha
    cell = np.rint((points - low) / alpha).astype(int)
    near = np.zeros(cell.max(0) + BALL_CELLS + 2, np.uint8)
    near[tuple(cell.T)] = 1
    for axis in range(3):
        near = maximum_filter1d(near, 2 * BALL_CELLS + 1, axis=axis, mode="constant")
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
    large = area >= min(area.max(), SMALLEST_PIECE * 4 * np.pi * alpha**2)
    return surface.part((large & (volume > 0))[piece])


FACETS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite to each corner


def alpha_shape(
    points: np.ndarray, alpha: float, smoothing: int, inside: np.ndarray | None = None
) -> SurfaceMesh:
    """Return the outer boundary of the alpha shape of points (N, 3), smoothed; lengths in metres.

    It has no triangles that are outside on both sides. Where more than two meet at an edge, some
    are left out: it is not closed there. If α is too small, the ball rolls in between the points,
    and shreds are left. So α is raised until the ball reaches no place ``inside`` (M, 3).

    Source: Edelsbrunner, Kirkpatrick and Seidel, 1983 (see the module).

    Example:
        >>> grid = np.stack(np.mgrid[:6, :6, :6], -1).reshape(-1, 3)
        >>> jittered = grid / 10 + np.random.default_rng(0).normal(0, 1e-3, (216, 3))
        >>> box = alpha_shape(jittered, alpha=0.12, smoothing=0)
        >>> print(f"{box.volumes().sum():.2f} m³")  # its sides are 0.5 m long
        0.13 m³
    """
    from scipy.spatial import Delaunay

    cells = Delaunay(points)
    corners, count = cells.simplices.astype(np.int64), len(cells.simplices)
    over = np.where(cells.neighbors < 0, count, cells.neighbors)  # number `count`: all outside
    balls = _smallest_empty_balls(points, corners, over)
    if inside is not None:
        within = cells.find_simplex(inside)
        within = within[within >= 0]
        larger = np.unique(balls[np.isfinite(balls) & (balls > alpha)])
        kept = lambda x: not _outside(over, balls <= x)[within].any()
        if not kept(alpha):
            alpha = larger[bisect_left(larger[:-1], True, key=kept)]
    outside = _outside(over, balls <= alpha)
    boundary = ~outside[:-1, None] & outside[over]
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


def _outside(over: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Return which tetrahedra (C + 1,) are reached from outside, the last one.

    ``over`` is that of :func:`_smallest_empty_balls`; ``closed`` (C, 4): triangles with μ ≤ α.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(over)
    cell = np.broadcast_to(np.arange(count)[:, None], over.shape)
    passed = cell[~closed], over[~closed]
    graph = coo_array((np.ones(len(passed[0]), bool), passed), (count + 1, count + 1))
    part = connected_components(graph, directed=False)[1]
    return part == part[count]


def _smallest_empty_balls(points: np.ndarray, corners: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return μ of eq. 2 of the four triangles of tetrahedra ``corners`` (C, 4), (C, 4) metres.

    ``over`` (C, 4) is the tetrahedron beyond the triangle opposite to each corner; C: none.
    """
    triangles = corners[:, FACETS]
    radius, centre = _circles(points[triangles])
    holds_apex = np.linalg.norm(points[corners] - centre, axis=2) < radius
    _, which = np.unique(np.sort(triangles.reshape(-1, 3), axis=1), axis=0, return_inverse=True)
    which = which.reshape(radius.shape)  # a number for each triangle, seen from either side
    empty = np.bincount(which.ravel(), holds_apex.ravel())[which] == 0
    of_cell = np.append(_spheres(points[corners]), np.inf)
    return np.where(empty, radius, np.minimum(of_cell[:-1, None], of_cell[over]))


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


DARTS_PER_QUERY = 2048  # whose neighbours are queried together; chosen: few of them are removed


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface, no two too close, from :func:`resample`.

    Example:
        >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> sheet = SurfaceMesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
        >>> found = resample(sheet, 100, np.ones(4), np.random.default_rng(0))
        >>> bool(found.spacing.min() > 0.05), found.normals[0]  # a grid has 0.1
        (True, array([0., 0., 1.]))
    """

    points: np.ndarray  # (N, 3) metres
    normals: np.ndarray  # (N, 3)
    spacing: np.ndarray  # (N,) metres, mean distance to the nearest others


def resample(
    surface: SurfaceMesh, count: int, density: np.ndarray, rng: np.random.Generator
) -> SurfacePoints:
    """Draw about ``count`` points on a surface, with a density (V,) given at its vertices.

    Many candidates are drawn with that density. In random order, each one that is left removes all
    others within its radius, ~ density^(-1/2): darts of variable radius, corrected until the count
    fits. The densest packing has count · r² · √3 / 2 = area; darts reach DART_RADIUS of that r.

    Example:
        >>> from skimage.measure import marching_cubes
        >>> at = np.mgrid[-6:7, -6:7, -6:7] / 20
        >>> vertices, faces, _, _ = marching_cubes(np.linalg.norm(at, axis=0), 0.2)
        >>> ball = SurfaceMesh((vertices - 6) / 20, faces.astype(np.int64))
        >>> even = np.ones(len(ball.vertices))
        >>> found = resample(ball, 200, even, np.random.default_rng(0))
        >>> abs(len(found.points) - 200) <= 10, found.normals.shape == found.points.shape
        (True, True)
    """
    from scipy.spatial import cKDTree

    v, f = surface.vertices, surface.faces
    mass = surface.areas() * density[f].mean(1)
    chosen = rng.choice(len(f), OVERSAMPLING * count, p=mass / mass.sum())
    barycentric = rng.dirichlet([1, 1, 1], len(chosen))[:, :, None]
    on_faces = lambda x: (x[f[chosen]] * barycentric).sum(1)
    points, tree = on_faces(v), cKDTree(on_faces(v))
    at_points = on_faces(density[:, None])[:, 0]
    radius = DART_RADIUS * np.sqrt(2 / 3**0.5 * mass.sum() / count / at_points)
    for _ in range(3):
        kept = _throw_darts(tree, points, radius)
        if abs(len(kept) / count - 1) < COUNT_TOLERANCE:
            break
        radius *= np.sqrt(len(kept) / count)
    points, normals = points[kept], on_faces(surface.normals())[kept]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return SurfacePoints(points, normals, mean_distance(points, 3))


def mean_distance(points: np.ndarray, neighbours: int) -> np.ndarray:
    """Return the mean distance of each point (N, 3) to its nearest neighbours, (N,).

    Example:
        >>> mean_distance(np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), neighbours=2)
        array([2. , 1.5, 2.5])
    """
    from scipy.spatial import cKDTree

    return cKDTree(points).query(points, k=neighbours + 1, workers=-1)[0][:, 1:].mean(1)


def _throw_darts(tree: cKDTree, points: np.ndarray, radius: np.ndarray) -> list[int]:
    """Return indices of points that remain if each removes all later ones within its radius."""
    alive = np.ones(len(points), dtype=bool)
    kept = []
    for first in range(0, len(points), DARTS_PER_QUERY):
        darts = first + np.flatnonzero(alive[first : first + DARTS_PER_QUERY])  # most are removed
        around = tree.query_ball_point(points[darts], radius[darts], return_sorted=False)
        for i, close in zip(darts, around, strict=True):
            if alive[i]:
                kept.append(i)
                alive[close] = False
    return kept


def with_fingers(surface: SurfaceMesh, rig: Rig) -> SurfaceMesh:
    """Replace the fingers of a surface by the fingers of the rest body.

    Example:
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> body = SurfaceMesh(rig.vertices.double().numpy(), rig.faces.numpy())
        >>> with_fingers(body, rig).faces.shape[0] <= len(body.faces)
        True
    """
    from scipy.spatial import cKDTree

    body, faces = rig.vertices.double().numpy(), rig.faces.numpy()
    finger = finger_weights(rig.weights).numpy() > 0.5
    if not finger.any():
        return surface
    bridged = finger[cKDTree(body).query(surface.vertices[surface.faces].mean(1))[1]]
    finger_faces = faces[finger[faces].all(1)] + len(surface.vertices)
    both = np.vstack([surface.vertices, body]), np.vstack([surface.faces[~bridged], finger_faces])
    return SurfaceMesh(*both).part(np.ones(len(both[1]), dtype=bool))


SPREAD_ANGLE = 0.4  # radians, of hips and shoulders; chosen: trouser legs come apart
WEIGHTING_POINTS = 8  # nearest points whose weights a vertex takes; chosen: all around it
SMALLEST_DISTANCE = 1e-3  # metres; closer points count alike; chosen: less than any spacing


@dataclass(frozen=True)
class SpreadLimbs:
    """Points with skinning weights, moved to a pose with the limbs spread.

    Example:
        The feet move apart, and back.

        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> rig = Rig.of(load_body(), Shape(torch.zeros(10)))
        >>> chosen = [JOINTS.index("left_foot")] * 4 + [JOINTS.index("right_foot")] * 4
        >>> feet = rig.joints[chosen].double().numpy()
        >>> spread = SpreadLimbs.of(rig, feet, np.eye(55)[chosen])
        >>> print(f"{np.ptp(feet[:, 0]):.2f} m, {np.ptp(spread.points[:, 0]):.2f} m")
        0.23 m, 0.91 m
        >>> back = spread.at_rest(spread.points)
        >>> bool(np.allclose(back, feet))
        True
    """

    points: np.ndarray  # (N, 3) metres, x of eq. 4
    weights: np.ndarray  # (N, 55) rows sum to 1
    T: np.ndarray  # (55, 4, 4) of eq. 4: from the rest pose to the one with the limbs spread

    @staticmethod
    def of(rig: Rig, points: np.ndarray, weights: np.ndarray) -> SpreadLimbs:
        """Move points (N, 3) at rest, with skinning weights (N, 55), as in eq. 4."""
        rotations = torch.zeros(1, len(JOINTS), 3, dtype=torch.float64)
        for side, angle in (("left", SPREAD_ANGLE), ("right", -SPREAD_ANGLE)):
            for limb in ("hip", "shoulder"):
                rotations[0, JOINTS.index(f"{side}_{limb}"), 2] = angle
        at_rest, here = rig.joints.double(), torch.zeros(1, 3, dtype=torch.float64)
        T = turn_joints(rotations, at_rest, rig.parents, here)[1][0].numpy()
        A = _blended(weights, T)
        moved = np.einsum("nij,nj->ni", A[:, :, :3], points) + A[:, :, 3]
        return SpreadLimbs(moved, weights, T)

    def at_rest(self, vertices: np.ndarray) -> np.ndarray:
        """Move vertices (V, 3) of a surface around the points back, as in eq. 5."""
        from scipy.spatial import cKDTree

        distance, nearest = cKDTree(self.points).query(vertices, k=WEIGHTING_POINTS, workers=-1)
        share = 1 / np.maximum(distance, SMALLEST_DISTANCE) ** 2
        share /= share.sum(1, keepdims=True)
        A = _blended(np.einsum("vk,vkj->vj", share, self.weights[nearest]), self.T)
        return np.einsum("vij,vj->vi", inverse(A[:, :, :3]), vertices - A[:, :, 3])


def _blended(weights: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return A of eq. 4, (N, 3, 4)."""
    return np.einsum("nj,jik->nik", weights, T[:, :3])
