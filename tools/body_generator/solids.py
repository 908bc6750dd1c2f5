"""Implicit solids, the surface of their smooth union, and its mirror image.

Each solid has a signed ``distance`` at points, about Euclidean near the surface, metres, and a box
``bounds`` that contains it. A body is a list of solids; each is joined to the ones before it (or
carved out) with a fillet of k metres:

    union(a, b) = min(a, b) − k h³ / 6,    h = max(k − |a − b|, 0) / k

Coordinates are three arrays that broadcast together.

Only half of a body is modelled, open at x = 0; its mirror image closes it:

==================  ================================================================
``border_of``       the border of the half
``onto_border``     restores the border's outline, which decimation changes
``without_chords``  removes edges that the mirror image would share
``mirrored``        welds both halves along the border
==================  ================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Coordinates = Sequence[np.ndarray]  # x, y, z, metres
Box = tuple[np.ndarray, np.ndarray]  # the lowest and the highest corner, (3,) each

_NO_DIVISION_BY_ZERO = 1e-9  # added to a divisor; chosen: far below any size here, metres


@dataclass(frozen=True)
class Cone:
    """Two balls and the cone that touches both."""

    start: Sequence[float]
    end: Sequence[float]
    radius_start: float
    radius_end: float

    def distance(self, at: Coordinates) -> np.ndarray:
        a, b = np.asarray(self.start), np.asarray(self.end)
        bone = b - a
        square = bone @ bone + _NO_DIVISION_BY_ZERO
        along = np.clip(sum((x - a[k]) * bone[k] for k, x in enumerate(at)) / square, 0, 1)
        square = sum((x - a[k] - along * bone[k]) ** 2 for k, x in enumerate(at))
        return np.sqrt(square) - (self.radius_start + (self.radius_end - self.radius_start) * along)

    def bounds(self) -> Box:
        r = max(self.radius_start, self.radius_end)
        return np.minimum(self.start, self.end) - r, np.maximum(self.start, self.end) + r


@dataclass(frozen=True)
class Ball:
    """An ellipsoid, rotated about the x, then the y, then the z axis."""

    centre: Sequence[float]
    radii: Sequence[float]
    turn: Sequence[float] = (0.0, 0.0, 0.0)  # radians

    def distance(self, at: Coordinates) -> np.ndarray:
        offset = [x - c for x, c in zip(at, self.centre, strict=True)]
        local = [sum(row[k] * offset[k] for k in range(3)) for row in self._axes().T]
        level = np.sqrt(sum((p / r) ** 2 for p, r in zip(local, self.radii, strict=True)))
        slope = np.sqrt(sum((p / r**2) ** 2 for p, r in zip(local, self.radii, strict=True)))
        outside = level * (level - 1) / (slope + _NO_DIVISION_BY_ZERO)
        return np.where(level > 1e-3, outside, -min(self.radii))

    def bounds(self) -> Box:
        half = np.sqrt((self._axes() ** 2) @ np.square(self.radii))
        return np.asarray(self.centre) - half, np.asarray(self.centre) + half

    def _axes(self) -> np.ndarray:
        axes = np.eye(3)
        for axis, angle in enumerate(self.turn):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            R = np.eye(3)
            R[i, i] = R[j, j] = np.cos(angle)
            R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
            axes = R @ axes
        return axes


@dataclass(frozen=True)
class Loft:
    """Elliptic sections along one axis, interpolated smoothly and closed by half ellipsoids.

    A section is ``(t, c, d, -c, +c, -d, +d)``: its position on the axis, its centre on the other
    two axes in the order x, y, z, and its radii toward lower and higher c, lower and higher d.
    """

    axis: int
    sections: Sequence[Sequence[float]]
    power: float = 2.0  # 2 is an ellipse; larger powers approach a box
    caps: tuple[float, float] = (0.02, 0.02)  # m, height of the closing half ellipsoids

    def distance(self, at: Coordinates) -> np.ndarray:
        from scipy.interpolate import PchipInterpolator

        table = np.asarray(self.sections, dtype=np.float64)
        t, (u, v) = at[self.axis], (x for k, x in enumerate(at) if k != self.axis)
        inside = np.clip(t, table[0, 0], table[-1, 0])
        section = PchipInterpolator(table[:, 0], table[:, 1:])(inside)
        c, d, c_low, c_high, d_low, d_high = np.moveaxis(section, -1, 0)
        u, v, beyond = u - c, v - d, t - inside
        a, b = np.where(u > 0, c_high, c_low), np.where(v > 0, d_high, d_low)
        level = (np.abs(u / a) ** self.power + np.abs(v / b) ** self.power) ** (2 / self.power)
        level = np.sqrt(level + (beyond / np.where(beyond > 0, self.caps[1], self.caps[0])) ** 2)
        length = np.sqrt(u * u + v * v + beyond * beyond)
        outside = length * (1 - 1 / (level + _NO_DIVISION_BY_ZERO))
        return np.where(level > 1e-3, outside, -np.minimum(a, b))

    def bounds(self) -> Box:
        table = np.asarray(self.sections, dtype=np.float64)
        low, high = np.zeros(3), np.zeros(3)
        low[self.axis], high[self.axis] = table[0, 0] - self.caps[0], table[-1, 0] + self.caps[1]
        for column, axis in enumerate(k for k in range(3) if k != self.axis):
            low[axis] = (table[:, 1 + column] - table[:, 3 + 2 * column]).min()
            high[axis] = (table[:, 1 + column] + table[:, 4 + 2 * column]).max()
        return low, high


Solid = Cone | Ball | Loft


@dataclass(frozen=True)
class Join:
    """A solid and how it is joined to the body."""

    solid: Solid
    blend: float  # fillet, metres
    carve: bool = False  # subtract it instead


def surface(joins: Sequence[Join], axes: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Extract a surface by marching cubes on a grid whose planes may be unevenly spaced.

    ``axes`` are x, y, z of these planes, increasing; the surface is open at the grid's border.
    Solids are joined in their order. Returns vertices (V, 3), and faces (F, 3) counter-clockwise
    seen from outside.
    """
    from skimage.measure import marching_cubes

    field = np.full([len(axis) for axis in axes], 0.2, dtype=np.float32)
    for join in joins:
        low, high = join.solid.bounds()
        margin = join.blend + 0.012  # beyond it the solid cannot change the surface
        box = tuple(
            slice(*np.searchsorted(axis, (low[k] - margin, high[k] + margin)))
            for k, axis in enumerate(axes)
        )
        at = np.ix_(*(axis[s] for axis, s in zip(axes, box, strict=True)))
        if all(s.start < s.stop for s in box):
            sign = -1 if join.carve else 1
            field[box] = sign * _union(sign * field[box], join.solid.distance(at), join.blend)
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    places = [np.interp(vertices[:, k], np.arange(len(axis)), axis) for k, axis in enumerate(axes)]
    return np.stack(places, axis=1), faces.astype(np.int64)


def _union(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - k * h**3 / 6


def border_of(faces: np.ndarray) -> np.ndarray:
    """Return the vertices of a half's open border in order, once around."""
    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    inner = set(map(tuple, sides[:, ::-1].tolist()))
    after = {a: b for a, b in sides.tolist() if (a, b) not in inner}
    loop = [min(after)]
    while (following := after[loop[-1]]) != loop[0]:
        loop.append(following)
    if len(loop) != len(after):
        raise ValueError("border_of(): the half must have one border, without a pinch")
    return np.array(loop)


def onto_border(vertices: np.ndarray, faces: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return vertices (V, 3) with the border of a decimated half back on its outline (S, 3).

    Decimation slides vertices along straight stretches and past each other, which folds faces. So
    they are placed on the outline, the border before decimation, in the order of the border.
    """
    moved = border_of(faces)
    start, along = outline, np.roll(outline, -1, axis=0) - outline
    t = ((vertices[moved, None] - start) * along).sum(-1) / ((along * along).sum(-1) + 1e-18)
    t = np.clip(t, 0, 1)
    gap = np.linalg.norm(vertices[moved, None] - start - t[..., None] * along, axis=-1)
    nearest = gap.argmin(1)
    length = np.linalg.norm(along, axis=1)
    before = np.concatenate([[0], np.cumsum(length)])
    place = before[nearest] + (t * length)[np.arange(len(moved)), nearest]
    # Start where the outline does, except for vertices that slid past that point.
    turn = int(np.argmin(place))
    place = np.sort(np.roll(place, -turn))
    closed = np.concatenate([outline, outline[:1]])
    vertices = vertices.copy()
    placed = [np.interp(place, before, closed[:, k]) for k in range(3)]
    vertices[np.roll(moved, -turn)] = np.stack(placed, axis=1)
    return vertices


def without_chords(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Prepare the border of a half for welding to its mirror image.

    A chord is an inner edge between two border vertices, which both halves would share. Faces with
    all corners on the border are removed; other chords get a vertex in their middle.
    """
    while True:
        edges, count = _edges(faces)
        on_border = np.isin(np.arange(len(vertices)), edges[count == 1])
        flat = on_border[faces].all(1)
        if not flat.any():
            break
        faces = faces[~flat]
    for a, b in edges[(count == 2) & on_border[edges].all(1)]:
        both = np.flatnonzero((faces == a).any(1) & (faces == b).any(1))
        middle, corners = len(vertices), np.unique(faces[both])
        vertices = np.concatenate([vertices, vertices[corners].mean(0, keepdims=True)])
        halves = [np.where(faces[both] == end, middle, faces[both]) for end in (a, b)]
        faces = np.concatenate([np.delete(faces, both, axis=0), *halves])
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def mirrored(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weld both halves: return vertices, faces, and the mirror image of each vertex (V,)."""
    edges, count = _edges(faces)
    border = np.unique(edges[count == 1])
    inner = np.setdiff1d(np.arange(len(vertices)), border)
    vertices = vertices.copy()
    vertices[border, 0] = 0
    vertices[inner, 0] = np.maximum(vertices[inner, 0], 1e-5)
    image = np.arange(len(vertices))
    image[inner] = len(vertices) + np.arange(len(inner))
    both = np.concatenate([vertices, vertices[inner] * (-1, 1, 1)])
    return both, np.concatenate([faces, image[faces][:, ::-1]]), np.concatenate([image, inner])


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return undirected edges (E, 2), and the number of faces of each (E,)."""
    sides = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)
