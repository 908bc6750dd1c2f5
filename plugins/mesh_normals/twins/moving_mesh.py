"""Meshes that move, in float64: what the slow twins of ``mesh_normals`` look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gva_mi_plugins.mesh_normals.twins.measured_sensor import MeasuredSensor

STILL = 1e-6  # of the greatest speed: what moves less stands still, but for rounding


@dataclass(frozen=True)
class MovingMesh:
    """A mesh and a direction in which its vertices move."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3)
    motion: np.ndarray  # (V, 3) dx
    facets: bool = False  # else smooth

    def at(self, step: float) -> np.ndarray:
        """Vertices after a step, (V, 3)."""
        return self.vertices + step * self.motion


def joined_vertices(meshes: Sequence[MovingMesh], step: float) -> np.ndarray:
    """Vertices after a step of all meshes, one after the other, (V, 3)."""
    return np.concatenate([mesh.at(step) for mesh in meshes])


def joined_faces(meshes: Sequence[MovingMesh]) -> np.ndarray:
    """The faces of all meshes, (F, 3), by the numbers of their joined vertices."""
    before = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return np.concatenate([mesh.faces + n for mesh, n in zip(meshes, before, strict=True)])


def corner_normals(meshes: Sequence[MovingMesh], step: float) -> np.ndarray:
    """Unit shading normals at corners, world, (F, 3, 3) of all meshes."""
    result = []
    for mesh in meshes:
        v, f = mesh.at(step), mesh.faces
        c = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        if mesh.facets:
            corners = np.repeat(c[:, None], 3, axis=1)
        else:
            n = np.zeros_like(v)
            np.add.at(n, f.ravel(), np.repeat(c, 3, axis=0))
            corners = n[f]
        result.append(corners / np.linalg.norm(corners, axis=2, keepdims=True))
    return np.concatenate(result)


def window(
    meshes: Sequence[MovingMesh], sensor: MeasuredSensor, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """The rectangle of pixels in which something moves: its first (2,) and its end (2,), x y."""
    speeds = [np.linalg.norm(mesh.motion, axis=1) for mesh in meshes]
    least = STILL * max(speed.max() for speed in speeds)
    ends = []
    for mesh, speed in zip(meshes, speeds, strict=True):
        moves = speed > least
        # Their neighbours' shading normals move with them.
        moves |= np.isin(np.arange(len(moves)), mesh.faces[moves[mesh.faces].any(1)])
        ends += [mesh.at(s)[moves] for s in (step, -step)]
    q = sensor.project(np.concatenate(ends))
    size = [sensor.width, sensor.height]
    low = np.clip(np.floor(q.min(0)) - 1, 0, size).astype(int)
    high = np.clip(np.ceil(q.max(0)) + 1, 0, size).astype(int)
    return low, high
