"""Clothes and hair as closed surfaces of their own, outside the body in its rest pose.

Every garment is the zero level set of a scalar field f (negative inside, metres), made from one
distance d to the body's surface:

    cloth    f = smax( drape(d) - looseness(x),  cuts(x) )            hems, sleeves, neckline
    opening  f = smax( f, -hollow )                                   a wall of cloth, not a plug
    hair     f = smax( smin( d_head - thickness, volume(x) ), -face )

where smax and smin are the smooth maximum and minimum. Level sets cannot intersect themselves, are
closed, and always show a face that looks outwards, so silhouettes and normals are well defined.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gva_mi.data.synthetic.texture import Cone

CLOTH_CELL = 0.0075  # m, grid of clothes: about two pixels of a 512² picture
HAIR_CELL = 0.005  # m, grid of hair and shoes
PLEAT = 0.055  # m, depth of a skirt's pleats per metre below the hips
BAND = 0.05  # m, how far from the surface distances are exact


@dataclass(frozen=True)
class Mesh:
    """A closed triangle mesh in the rest pose."""

    vertices: np.ndarray  # (V, 3) metres
    faces: np.ndarray  # (F, 3) counter-clockwise seen from outside
    shade: np.ndarray  # (V,) in [0, 1]: how much light the cloth itself leaves, dark in openings


@dataclass(frozen=True)
class Grid:
    """A block of regular cells; ``x``, ``y``, ``z`` broadcast to its shape."""

    lo: np.ndarray  # (3,) metres
    cell: float  # metres
    shape: tuple[int, int, int]

    @staticmethod
    def around(lo: np.ndarray, hi: np.ndarray, cell: float) -> Grid:
        shape = np.ceil((np.asarray(hi) - lo) / cell).astype(int) + 1
        return Grid(np.asarray(lo, dtype=np.float64), cell, tuple(int(n) for n in shape))

    def axis(self, k: int) -> np.ndarray:
        values = (self.lo[k] + self.cell * np.arange(self.shape[k])).astype(np.float32)
        return values.reshape([-1 if i == k else 1 for i in range(3)])

    x = property(lambda self: self.axis(0))
    y = property(lambda self: self.axis(1))
    z = property(lambda self: self.axis(2))


def smax(a: np.ndarray, b: np.ndarray, k: float = 0.012) -> np.ndarray:
    """Smooth maximum: rounds the edge between two fields over about ``k`` metres."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.maximum(a, b) + h * h * (k / 4)


def smin(a: np.ndarray, b: np.ndarray, k: float = 0.012) -> np.ndarray:
    """Smooth minimum."""
    return -smax(-a, -b, k)


def smoothstep(x: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """0 below ``lo``, 1 above ``hi``, smooth between."""
    t = np.clip((x - lo) / (hi - lo), 0, 1)
    return t * t * (3 - 2 * t)


class BodySurface:
    """The rest surface as oriented points, for signed distances that are smooth."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> None:
        from scipy.spatial import cKDTree

        corners, directions = vertices[faces], normals[faces]
        # vertices, edge midpoints and face centres: points about 7 mm apart
        weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [3, 3, 0], [0, 3, 3]])
        weights = weights / weights.sum(1, keepdims=True)
        self.points = np.concatenate([vertices, *np.einsum("wk,fkc->wfc", weights, corners)])
        normals = np.concatenate([normals, *np.einsum("wk,fkc->wfc", weights, directions)])
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self.tree = cKDTree(self.points)

    def distance(self, x: np.ndarray, smooth: float = 0.012) -> np.ndarray:
        """Signed distance (N,) of points (N, 3): the mean of the nearest tangent planes."""
        distance, index = self.tree.query(x, k=6, workers=-1)
        weight = np.exp((distance[:, :1] ** 2 - distance**2) / smooth**2)
        height = np.einsum("nkc,nkc->nk", x[:, None] - self.points[index], self.normals[index])
        plane = (weight * height).sum(1) / weight.sum(1)
        return np.where(np.abs(plane) > distance[:, 0], np.sign(plane) * distance[:, 0], plane)

    def sample(self, grid: Grid) -> np.ndarray:
        """The distance on a grid: exact within ``BAND``, from the grid itself beyond."""
        from scipy.ndimage import distance_transform_edt

        cells = np.round((self.points - grid.lo) / grid.cell).astype(int)
        cells = cells[((cells >= 0) & (cells < grid.shape)).all(1)]
        empty = np.ones(grid.shape, dtype=bool)
        empty[tuple(cells.T)] = False
        coarse = distance_transform_edt(empty).astype(np.float32) * grid.cell
        near = coarse < BAND
        at = np.argwhere(near) * grid.cell + grid.lo
        values = coarse
        values[near] = self.distance(at)
        # Far cells are outside, but those the surface shuts in: deep inside the trunk.
        inside = _deep_inside(values, near)
        values[inside] *= -1
        return values


def _deep_inside(values: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Far cells that touch near cells of negative distance."""
    from scipy.ndimage import label

    blobs, count = label(~near)
    if count == 0:
        return np.zeros_like(near)
    total = np.zeros(count + 1)
    for axis in range(3):
        for a, b in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            index_a = tuple(a if i == axis else slice(None) for i in range(3))
            index_b = tuple(b if i == axis else slice(None) for i in range(3))
            touch = (blobs[index_a] > 0) & near[index_b]
            sign = np.sign(values[index_b][touch])
            total += np.bincount(blobs[index_a][touch], sign, count + 1)
    return (total < 0)[blobs] & ~near


def surface_of(grid: Grid, field: np.ndarray, uncut: np.ndarray | None = None) -> Mesh:
    """The zero level set as a mesh; where it lies deep inside ``uncut`` it is in shade."""
    import trimesh
    from scipy.ndimage import map_coordinates
    from skimage.measure import marching_cubes

    field = np.pad(field, 1, constant_values=1.0)  # closed at the block's border
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    parts = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(faces)))
    parts = [p for p in parts if len(p) > 400]  # crumbs where two fields barely meet
    faces = faces[np.sort(np.concatenate(parts))]
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used].astype(np.float64) - 1
    shade = np.ones(len(vertices), dtype=np.float32)
    if uncut is not None:
        depth = map_coordinates(uncut, vertices.T, order=1, mode="nearest")
        shade = 1 - 0.65 * smoothstep(-depth, 0.006, 0.014) - 0.2 * smoothstep(-depth, 0.014, 0.04)
    faces = faces.reshape(-1, 3)
    vertices = vertices * grid.cell + grid.lo
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    if np.einsum("fc,fc->", a, np.cross(b, c)) < 0:
        faces = faces[:, ::-1]
    return Mesh(vertices.astype(np.float32), np.ascontiguousarray(faces), shade.astype(np.float32))


def _drape(d: np.ndarray, grid: Grid, length: float = 0.05) -> np.ndarray:
    """The distance smoothed along the vertical: cloth hangs straight where the body is hollow."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(d, length / grid.cell, axis=1)


def _with_opening(
    field: np.ndarray, uncut: np.ndarray, cut: np.ndarray, wall: float, depth: float = 0.04
) -> np.ndarray:
    """Cut ``field`` where ``cut`` > 0 and hollow it out behind the cut."""
    hollow = np.maximum(uncut + wall, -cut - depth)
    return smax(smax(field, cut), -hollow, 0.004)


def shirt(
    grid: Grid,
    d: np.ndarray,
    joints: Mapping[str, np.ndarray],
    loose: float,
    sleeve: float,
    hem: float,
    rng: np.random.Generator,
) -> Mesh:
    """A shirt.

    Args:
        grid, d: the body's distance on its grid.
        joints: rest positions by name.
        loose: how far the cloth stands off, metres.
        sleeve: where sleeves end, in (0, 2): 1 is the elbow, 2 the wrist.
        hem: how far below the pelvis it ends, metres.
        rng: for the folds.
    """
    pelvis, neck = joints["pelvis"], joints["neck"]
    shoulder, elbow, wrist = (joints[f"left_{n}"] for n in ("shoulder", "elbow", "wrist"))
    x, y, z = grid.x, grid.y, grid.z
    trunk = 1 - smoothstep(np.abs(x), 0.75 * shoulder[0], 1.05 * shoulder[0])
    trunk = trunk * (1 - smoothstep(y, shoulder[1] - 0.16, shoulder[1] - 0.06))
    draped = d * (1 - trunk) + trunk * _drape(d, grid)

    drop = smoothstep(shoulder[1] - y, 0.05, shoulder[1] - pelvis[1] + hem)  # 0 at the shoulder
    out = smoothstep(np.abs(x), shoulder[0], wrist[0])
    angle = np.arctan2(z - pelvis[2], x)
    folds = np.zeros(grid.shape, dtype=np.float32)
    for n in (5, 8, 11):
        phase, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(-12, 12)
        folds += np.cos(n * angle + phase + tilt * y) / 3
    cuffs = np.sin(x * rng.uniform(90, 120) + 14 * (z + y)) * smoothstep(out, 0.25, 0.6)
    stand_off = loose * (0.55 + 0.6 * drop * trunk + 0.35 * out) + 0.006
    stand_off = stand_off + 0.35 * loose * (folds * drop * trunk + 0.35 * cuffs)
    uncut = draped - stand_off

    if sleeve <= 1:
        end = shoulder[0] + sleeve * (elbow[0] - shoulder[0])
    else:
        end = elbow[0] + (sleeve - 1) * (wrist[0] - elbow[0])
    wall = 0.012
    field = _with_opening(uncut, uncut, np.abs(x) - end + 0 * y + 0 * z, wall)
    field = _with_opening(field, uncut, (pelvis[1] - hem) - y + 0 * x + 0 * z, wall)
    # The neckline: a capsule around the neck, lower in front.
    head = joints["head"]
    low = neck + np.array([0, 0.0, 0.015])
    axis = (head - neck) / np.linalg.norm(head - neck)
    t = np.clip((x - low[0]) * axis[0] + (y - low[1]) * axis[1] + (z - low[2]) * axis[2], -0.01, 1)
    radius = np.sqrt(
        (x - low[0] - t * axis[0]) ** 2
        + (y - low[1] - t * axis[1]) ** 2
        + (z - low[2] - t * axis[2]) ** 2
    )
    neckline = 0.40 * np.linalg.norm(joints["left_shoulder"] - neck) - radius
    field = smax(field, neckline, 0.015)
    collar = neck[1] + 0.03 - 0.35 * (z - neck[2])  # higher at the nape
    field = smax(field, y - collar + 0 * x, 0.015)
    return surface_of(grid, field, uncut)


def trousers(
    grid: Grid, d: np.ndarray, joints: Mapping[str, np.ndarray], loose: float, length: float
) -> Mesh:
    """Trousers or, with ``length`` below 1, shorts.

    Args:
        grid, d: the body's distance on its grid.
        joints: rest positions by name.
        loose: how far the hems stand off, metres.
        length: where they end, in (0, 2): 1 is the knee, 2 the ankle.
    """
    pelvis, hip, knee, ankle = (
        joints[n] for n in ("pelvis", "left_hip", "left_knee", "left_ankle")
    )
    y = grid.y
    below = smoothstep(hip[1] - y, 0.02, 0.25)
    calf = below * np.ones(grid.shape, dtype=np.float32)
    draped = d * (1 - calf) + calf * _drape(d, grid)
    top = pelvis[1] + 0.75 * (joints["spine1"][1] - pelvis[1])
    at_knee = knee[1] if length <= 1 else ankle[1]
    start = hip[1] if length <= 1 else knee[1]
    end = start + (length - (0 if length <= 1 else 1)) * (at_knee - start)
    uncut = draped - (0.009 + loose * smoothstep(hip[1] - y, 0.05, hip[1] - end))
    flat = 0 * grid.x + 0 * grid.z
    field = _with_opening(uncut, uncut, end - y + flat, 0.012)
    field = smax(field, y - top + flat)
    field = smax(field, np.abs(grid.x) - 0.42 * joints["left_elbow"][0] - 0.1 + 0 * y + 0 * grid.z)
    return surface_of(grid, field, uncut)


def skirt(
    grid: Grid,
    d: np.ndarray,
    joints: Mapping[str, np.ndarray],
    flare: float,
    length: float,
    rng: np.random.Generator,
) -> tuple[Mesh, Cone]:
    """A skirt: an elliptic cone with pleats that deepen toward the hem; and that cone.

    Args:
        grid, d: the body's distance on its grid.
        joints: rest positions by name.
        flare: growth of the radius per metre below the hips.
        length: where it ends, in (0, 2): 1 is the knee.
        rng: for the pleats.
    """
    pelvis, hip, knee = joints["pelvis"], joints["left_hip"], joints["left_knee"]
    x, y, z = grid.x, grid.y, grid.z
    end = hip[1] + length * (knee[1] - hip[1])
    top = pelvis[1] + 0.7 * (joints["spine1"][1] - pelvis[1])
    row = lambda height: int(np.clip((height - grid.lo[1]) / grid.cell, 0, grid.shape[1] - 1))
    body = (d < 0) & (np.abs(x) < 0.45 * joints["left_elbow"][0] + 0.1)
    hips = body[:, row(hip[1])]
    half_x = np.abs(grid.x[:, 0, 0])[hips.any(1)].max() + 0.014
    zs = grid.z[0, 0][hips.any(0)]
    half_z, mid_z = np.ptp(zs) / 2 + 0.014, (zs.max() + zs.min()) / 2
    least = flare - 1.6 * PLEAT  # growth where a pleat is deepest: the calves lie within it, too
    for level in range(row(end), row(hip[1])):
        out = np.abs(grid.z[0, 0][body[:, level].any(0)] - mid_z).max() + 0.014
        half_z = max(half_z, out - least * (hip[1] - grid.y[0, level, 0]))
    drop = np.maximum(hip[1] - y, 0)
    angle = np.arctan2(z - mid_z, x)
    pleats = np.cos(13 * angle + rng.uniform(0, 6)) + 0.6 * np.cos(7 * angle + rng.uniform(0, 6))
    grow = (flare + PLEAT * pleats) * drop
    outline = np.sqrt((x / half_x) ** 2 + ((z - mid_z) / half_z) ** 2)
    outline = (outline - 1) * min(half_x, half_z) - grow
    yoke = smax(d - 0.011, (hip[1] - 0.06) - y + 0 * d, 0.03)
    uncut = smin(smax(outline, y - hip[1] + 0 * outline, 0.03), yoke, 0.05)
    # Pleats make the field steeper than a distance: the wall is thinner than it says.
    field = _with_opening(uncut, uncut, end - y + 0 * outline, 0.022, 0.06)
    field = smax(field, y - top + 0 * outline)
    field = smax(field, np.abs(x) - half_x - flare * 0.6 + 0 * y + 0 * z)
    slope = flare * (half_x + half_z) / (2 * min(half_x, half_z))  # of the mean radius
    radius = (half_x + half_z) / 2
    apex = (0.0, float(hip[1] + radius / slope), float(mid_z))
    return surface_of(grid, field, uncut), Cone(apex, float(slope), float(half_x / half_z))


def shoe(surface: BodySurface, joints: Mapping[str, np.ndarray], side: str, thick: float) -> Mesh:
    """One shoe with a flat sole.

    Args:
        surface: the body.
        joints: rest positions by name.
        side: "left" or "right".
        thick: how far the upper stands off, metres.
    """
    ankle = joints[f"{side}_ankle"]
    near = np.linalg.norm(surface.points - joints[f"{side}_foot"], axis=1) < 0.25
    foot = surface.points[near & (np.sign(surface.points[:, 0]) == np.sign(ankle[0]))]
    foot = foot[foot[:, 1] < ankle[1] + 0.06]
    ground = foot[:, 1].min()
    grid = Grid.around(foot.min(0) - 0.04, foot.max(0) + [0.04, 0.03, 0.04], HAIR_CELL)
    d = surface.sample(grid)
    y = grid.y
    sole_top = ground + 0.022
    level = int((sole_top - grid.lo[1]) / grid.cell)
    # Below its top the sole keeps the outline that the foot has there.
    d = np.where(y < sole_top, d[:, level : level + 1], d)
    sole = (1 - smoothstep(y, sole_top - 0.006, sole_top + 0.001)) * 0.006
    uncut = d - thick - sole
    field = smax(uncut, (ground - 0.014) - y + 0 * d, 0.008)
    top = ankle[1] + 0.012 + 0.25 * (ankle[2] - grid.z)  # higher at the heel
    return surface_of(grid, _with_opening(field, uncut, y - top + 0 * grid.x, 0.006, 0.02), uncut)
