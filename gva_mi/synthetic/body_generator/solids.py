"""Implicit solids, their smooth union, and its surface.

Each solid has a signed ``distance`` at points, about Euclidean near the surface, metres, and a box
``bounds`` that contains it. A body is a list of
solids; each is joined to those before it (or carved out) with a fillet of k metres:

    union(a, b) = min(a, b) − k h³ / 6,    h = max(k − |a − b|, 0) / k

Coordinates are three arrays that broadcast together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Coordinates = Sequence[np.ndarray]  # x, y, z, metres
Box = tuple[np.ndarray, np.ndarray]  # the lowest and the highest corner, (3,) each

_TINY = 1e-9


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
        along = sum((x - a[k]) * bone[k] for k, x in enumerate(at)) / (bone @ bone + _TINY)
        along = np.clip(along, 0, 1)
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
        return np.where(level > 1e-3, level * (level - 1) / (slope + _TINY), -min(self.radii))

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
        c, d, c_low, c_high, d_low, d_high = np.moveaxis(
            PchipInterpolator(table[:, 0], table[:, 1:])(inside), -1, 0
        )
        u, v, beyond = u - c, v - d, t - inside
        a, b = np.where(u > 0, c_high, c_low), np.where(v > 0, d_high, d_low)
        level = (np.abs(u / a) ** self.power + np.abs(v / b) ** self.power) ** (2 / self.power)
        level = np.sqrt(level + (beyond / np.where(beyond > 0, self.caps[1], self.caps[0])) ** 2)
        length = np.sqrt(u * u + v * v + beyond * beyond)
        return np.where(level > 1e-3, length * (1 - 1 / (level + _TINY)), -np.minimum(a, b))

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
            body, distance = field[box], join.solid.distance(at)
            if join.carve:
                field[box] = -_union(-body, distance, join.blend)
            else:
                field[box] = _union(body, distance, join.blend)
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    places = [np.interp(vertices[:, k], np.arange(len(axis)), axis) for k, axis in enumerate(axes)]
    return np.stack(places, axis=1), faces.astype(np.int64)


def _union(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - k * h**3 / 6
