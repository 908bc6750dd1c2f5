"""What the normals of a file decide: where a surface has hard edges, and which way normals point.

Shading normals are averages over faces, so that they move with the vertices. Where a file splits a
vertex, its own normals say why: they are equal along a seam of textures, and differ along a hard
edge. Where a file has none, Mitsuba invents them for every copy of a vertex alone (or leaves memory
as it was); then copies of a smooth mesh belong together unless they differ by a right angle or so.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

SAME = np.cos(np.radians(1.0))  # of the angle between normals of a file that mean the same
SMOOTH = np.cos(np.radians(60.0))  # of the angle between invented normals along a seam
INVENTED = 1e-2  # distance of a file's unit normals to what Mitsuba would invent, at most


def shared_normals(mesh: mi.Mesh, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return for each vertex of a smooth mesh the one whose shading normal it shares, (V,).

    ``points`` (V,) is for each vertex the first one at its place.
    """
    share = np.arange(len(points))
    if (points == share).all() or not mesh.has_vertex_normals():
        return points
    positions, normals = _vectors(mesh.vertex_positions_buffer()), _file_normals(mesh, faces)
    own = _by_angle(positions, faces)
    normals = own if normals is None else normals
    used = np.linalg.norm(own, axis=1) > 0.5
    invented = (np.linalg.norm(normals - own, axis=1)[used] < INVENTED).all()
    facets = (_dots(normals[faces], _crosses(positions, faces)[:, None]) > SAME).all()
    least = SMOOTH if invented and not facets else SAME
    order = np.argsort(points, kind="stable")
    for step in range(1, np.bincount(points).max()):
        later, earlier = order[step:], order[:-step]
        joined = (points[later] == points[earlier]) & (
            (normals[later] * normals[earlier]).sum(1) > least
        )
        share[later[joined]] = earlier[joined]
    while (share[share] != share).any():
        share = share[share]
    return share


def points_inward(mesh: mi.Mesh, faces: np.ndarray) -> bool:
    """Whether normals point against the winding: flipped, or as in a file that was mirrored."""
    normals = None if mesh.has_face_normals() else _file_normals(mesh, faces)
    if normals is None:
        return mesh.has_flipped_normals()
    c = _crosses(_vectors(mesh.vertex_positions_buffer()), faces)
    return bool((c[:, None] * normals[faces]).sum() < 0) != mesh.has_flipped_normals()


def _vectors(buffer: mi.Float) -> np.ndarray:
    return np.array(buffer, np.float64).reshape(-1, 3)


def _file_normals(mesh: mi.Mesh, faces: np.ndarray) -> np.ndarray | None:
    """Normals (V, 3) that a mesh came with; None if there are none, or other numbers."""
    if not mesh.has_vertex_normals():
        return None
    normals = _vectors(mesh.vertex_normals_buffer())
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(normals, axis=1)
    return normals if (np.abs(length[faces] - 1) < 1e-2).all() else None


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)


def _crosses(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Cross products of two sides of each face, (F, 3)."""
    a, b, c = positions[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a)


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cosines between vectors; 1 where one has no length."""
    size = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.where(size > 0, (a * b).sum(-1) / np.maximum(size, 1e-30), 1.0)


def _by_angle(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) by the angles of the faces at each vertex; zero where there are none."""
    corners, n = positions[faces], _unit(_crosses(positions, faces))
    total = np.zeros_like(positions)
    for k in range(3):
        a, b = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        np.add.at(total, faces[:, k], n * np.arccos(np.clip(_dots(a, b), -1, 1))[:, None])
    return _unit(total)
