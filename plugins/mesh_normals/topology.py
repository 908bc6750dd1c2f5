"""Topology of meshes, independent of positions: corners, normals, edges and faces.

Built once for the meshes of a scene, with numpy; the arrays are Mitsuba's. Names and sizes: ``V``
vertices of all meshes one after the other, ``F`` faces, ``E`` edges, ``N`` shading normals; corner
``k`` of face ``f`` is corner ``3 f + k``.

Three numberings of a corner:

* *vertex*: the entry in the vertex buffer, which carries position and gradient;
* *point*: vertices of one mesh at the same place are one point. Files split vertices along texture
  seams; an edge between split vertices is no border, and must not count as one;
* *normal*: corners that share a shading normal. A smooth mesh has one for each point, except where
  a file says that an edge is hard, a faceted one for each face.

**Faces without area** are invisible and change no edge around them. A face with two corners at one
place is left out. A face whose corners lie on a line may close a gap between its longest side and
the two others, where the edge of one neighbour was split. If the longest side has one other face
``C``, that face replaces it at the two others. ::

       C
    A ----- B            A - M - B      between C and D, and between C and E
    A - M - B
     D     E

**Normals of a file** decide where a surface has hard edges, and which way normals point. Shading
normals are averages over faces, so that they move with the vertices. Where a file splits a vertex,
the normals of the file tell the reason: they are equal along a seam of textures, and differ along a
hard edge. If a file has none, Mitsuba computes them for every copy of a vertex alone, or leaves the
memory uninitialised. Then copies of a smooth mesh belong together unless they differ by about a
right angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.segment_sums import Segments

# Height of a face, as a share of its greatest coordinate, up to which it has no area. Chosen: four
# times float32's rounding, 2^-24.
AREA_ROUNDING = 2.0**-22


class Sides(NamedTuple):
    """The sides of all faces: side ``k`` of face ``f`` is ``3 f + k``."""

    ends: np.ndarray  # (3F, 2) points at the ends, in the order in which the face runs
    live: np.ndarray  # (3F,) whether it belongs to an edge
    owner: np.ndarray  # (3F,) the face that it is a side of


def live_sides(points: np.ndarray, flat: np.ndarray, places: np.ndarray) -> Sides:
    """Find the sides of faces (side ``k`` of face ``f`` is ``3 f + k``) that belong to edges.

    Faces have ``points`` (F, 3) at ``places`` (V, 3); the faces ``flat`` (n,) have no area.
    """
    owner, live = np.arange(points.size) // 3, np.ones(points.size, bool)
    ends = np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2)
    live[(3 * flat[:, None] + np.arange(3)).ravel()] = False
    on_line = [face for face in flat.tolist() if len(set(points[face].tolist())) == 3]
    if not on_line:
        return Sides(ends, live, owner)
    length = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1).reshape(-1, 3)
    edge = [tuple(side) for side in np.sort(ends, axis=1).tolist()]
    at: dict[tuple[int, int], list[int]] = {}  # live sides of each edge
    for side in np.flatnonzero(live).tolist():
        at.setdefault(edge[side], []).append(side)
    for face in sorted(on_line, key=lambda f: -length[f].max()):
        k = int(length[face].argmax())
        longest, *others = (3 * face + (k + j) % 3 for j in range(3))
        beyond = at.get(edge[longest], [])
        if len(beyond) != 1:
            continue
        (side,) = beyond
        live[side], at[edge[longest]] = False, []
        for other in others:
            if (ends[longest] == ends[side]).all():  # the flat face is wound the other way
                ends[other] = ends[other, ::-1]
            live[other], owner[other] = True, owner[side]
            at.setdefault(edge[other], []).append(other)
    return Sides(ends, live, owner)


# Normals of a file within 1 degree are one normal. Chosen: files round them to few digits.
SAME_NORMAL_COSINE = np.cos(np.radians(1.0))
# Normals that Mitsuba computed for copies of a vertex belong together within 60 degrees. Chosen
# between a smooth seam and a right angle.
SMOOTH_SEAM_COSINE = np.cos(np.radians(60.0))
# Unit normals up to this distance from the normals that Mitsuba computes do not come from a file.
# Chosen: above float32 and the files' digits.
COMPUTED_NORMAL_DISTANCE = 1e-2
UNIT_LENGTH_TOLERANCE = 1e-2  # of a file's normals; longer or shorter ones are other numbers
SMALLEST_LENGTH = 1e-30  # divisor in the place of 0; any vector of a mesh is longer


def shared_normals(mesh: mi.Mesh, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return, for each vertex of a smooth mesh, the vertex whose shading normal it shares, (V,).

    ``points`` (V,) is, for each vertex, the first vertex at its place.
    """
    share = np.arange(len(points))
    if (points == share).all() or not mesh.has_vertex_normals():
        return points
    positions, normals = _vectors(mesh.vertex_positions_buffer()), _file_normals(mesh, faces)
    own = _by_angle(positions, faces)
    normals = own if normals is None else normals
    used = np.linalg.norm(own, axis=1) > 0.5
    computed = (np.linalg.norm(normals - own, axis=1)[used] < COMPUTED_NORMAL_DISTANCE).all()
    facets = (_dots(normals[faces], _crosses(positions, faces)[:, None]) > SAME_NORMAL_COSINE).all()
    least = SMOOTH_SEAM_COSINE if computed and not facets else SAME_NORMAL_COSINE
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
    """Return whether normals point against the winding: flipped, or by a mirrored file."""
    normals = None if mesh.has_face_normals() else _file_normals(mesh, faces)
    if normals is None:
        return mesh.has_flipped_normals()
    c = _crosses(_vectors(mesh.vertex_positions_buffer()), faces)
    return bool((c[:, None] * normals[faces]).sum() < 0) != mesh.has_flipped_normals()


def _vectors(buffer: mi.Float) -> np.ndarray:
    return np.array(buffer, np.float64).reshape(-1, 3)


def _file_normals(mesh: mi.Mesh, faces: np.ndarray) -> np.ndarray | None:
    """Return the normals (V, 3) of a mesh's file; None if it has none, or no unit vectors."""
    if not mesh.has_vertex_normals():
        return None
    normals = _vectors(mesh.vertex_normals_buffer())
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(normals, axis=1)
    return normals if (np.abs(length[faces] - 1) < UNIT_LENGTH_TOLERANCE).all() else None


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), SMALLEST_LENGTH)


def _crosses(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the cross product of two sides of each face, (F, 3)."""
    a, b, c = positions[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a)


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cosines between vectors; 1 where a vector has no length."""
    size = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.where(size > 0, (a * b).sum(-1) / np.maximum(size, SMALLEST_LENGTH), 1.0)


def _by_angle(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3), weighted by the faces' angles at each vertex; zero without faces.

    These are Mitsuba's own (Thürmer and Wüthrich, "Computing Vertex Normals from Polygonal Facets",
    1998).
    """
    corners, n = positions[faces], _unit(_crosses(positions, faces))
    total = np.zeros_like(positions)
    for k in range(3):
        a, b = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        np.add.at(total, faces[:, k], n * np.arccos(np.clip(_dots(a, b), -1, 1))[:, None])
    return _unit(total)


NO_FACES = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Topology:
    """The part of the meshes that stays the same while their vertices move."""

    vertex_counts: tuple[int, ...]  # of each mesh
    first_face: mi.UInt32  # of the mesh with a given number in Mitsuba's registry of shapes
    flips: mi.Bool  # (N,) the normal points against the winding of its faces
    flat: np.ndarray  # (n,) faces without area, which belong to no edge
    vertices: tuple[mi.UInt32, ...]  # three (F,): vertex of each corner
    points: tuple[mi.UInt32, ...]  # three (F,): point of each corner
    normals: tuple[mi.UInt32, ...]  # three (F,): normal of each corner
    ends: tuple[mi.UInt32, ...]  # two (E,): vertices at the ends of an edge
    end_points: tuple[mi.UInt32, ...]  # two (E,): points at the ends of an edge
    edge_faces: tuple[mi.UInt32, ...]  # K of (E,): faces at an edge, the first repeated to fill up
    # K of (E,): whether that face runs from the edge's first end to its second
    edge_runs: tuple[mi.Bool, ...]
    is_closed: bool  # every edge has two faces, and these are wound outward
    crease: mi.Bool  # (E,): the normal jumps here even between two faces seen from the front
    corners_of_vertex: Segments  # V segments over the 3F corners
    corners_of_point: Segments  # V segments over the 3F corners
    corners_of_normal: Segments  # N segments over the 3F corners
    faces_of_normal: Segments  # N segments over the F faces
    ends_of_vertex: Segments  # V segments over the 2E ends (end k of edge e is 2 e + k)

    @property
    def face_count(self) -> int:
        """Return the number of faces F."""
        return dr.width(self.vertices[0])

    @property
    def vertex_count(self) -> int:
        """Return the number of vertices V."""
        return sum(self.vertex_counts)

    def face_number(self, shape: mi.ShapePtr, primitive: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return face numbers (R,) from Mitsuba's shape and primitive numbers; 0 if not active."""
        shape = dr.reinterpret_array(mi.UInt32, shape)
        first = dr.gather(mi.UInt32, self.first_face, shape, active)
        return dr.select(active, first + primitive, 0)

    @staticmethod
    def of(meshes: Sequence[mi.Mesh], flat: np.ndarray = NO_FACES) -> Topology:
        """Read the faces of the meshes and find the edges between them.

        ``flat`` (n,) are further faces without area; faces with two corners at one place are found.
        """
        corners = _Corners.of(meshes)
        vertices, normals, V, N = corners.vertices, corners.normals, corners.V, corners.N
        repeated = (corners.points == np.roll(corners.points, 1, axis=1)).any(1)
        flat = np.union1d(flat, np.flatnonzero(repeated))
        corners_of_normal = Segments.by_owner(normals.reshape(-1), N)
        return Topology(
            vertex_counts=tuple(mesh.vertex_count() for mesh in meshes),
            first_face=_first_faces(meshes),
            flips=mi.Bool(corners.flips),
            flat=flat,
            vertices=_columns(vertices),
            points=_columns(corners.points),
            normals=_columns(normals),
            corners_of_vertex=Segments.by_owner(vertices.reshape(-1), V),
            corners_of_point=Segments.by_owner(corners.points.reshape(-1), V),
            corners_of_normal=corners_of_normal,
            faces_of_normal=Segments(corners_of_normal.start, corners_of_normal.items // 3),
            **_edges(corners, live_sides(corners.points, flat, corners.places)),
        )


def meshes_of(scene: mi.Scene) -> list[mi.Mesh]:
    """Return a scene's shapes except ellipsoids; all of them must be meshes.

    Raises:
        ValueError: a shape is no mesh, or there is none.
    """
    meshes = [shape for shape in scene.shapes() if not shape.is_ellipsoids()]
    for shape in meshes:
        if not shape.is_mesh():
            raise ValueError(
                "mesh_normals: every shape must be a triangle mesh, "
                f"'{shape.id()}' is {shape.class_name()}"
            )
    if not meshes:
        raise ValueError("mesh_normals: the scene has no mesh")
    return meshes


def without_ellipsoids(scene: mi.Scene) -> mi.Scene:
    """Return a scene for ray tracing: the scene itself, or a new one of its meshes alone.

    A scene with ellipsoids can be used by both plugins. Rays would end at the ellipsoids, so the
    meshes become a scene of their own. It is built again for every picture, because only the first
    scene is notified when meshes move.
    """
    if not any(shape.is_ellipsoids() for shape in scene.shapes()):
        return scene
    meshes = {f"mesh{k}": mesh for k, mesh in enumerate(meshes_of(scene))}
    return mi.load_dict({"type": "scene", **meshes})


def _first_faces(meshes: Sequence[mi.Mesh]) -> mi.UInt32:
    """Return the number of each mesh's first face, by its number in Mitsuba's registry."""
    registry = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))[0] for mesh in meshes]
    first = np.zeros(max(registry) + 1, np.uint32)
    counts = [mesh.face_count() for mesh in meshes]
    first[registry] = np.cumsum([0, *counts[:-1]])
    return mi.UInt32(first)


@dataclass(frozen=True)
class _Corners:
    """The three numberings of the corners of all meshes."""

    places: np.ndarray  # (V, 3)
    vertices: np.ndarray  # (F, 3)
    points: np.ndarray  # (F, 3)
    normals: np.ndarray  # (F, 3)
    flips: np.ndarray  # (N,) bool
    V: int
    N: int
    outward: bool  # each mesh has a volume that is not negative

    @staticmethod
    def of(meshes: Sequence[mi.Mesh]) -> _Corners:
        places, vertices, points, normals, flips = [], [], [], [], []
        V, N, outward = 0, 0, True
        for mesh in meshes:
            positions = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
            faces = np.array(mesh.faces_buffer()).reshape(-1, 3).astype(np.int64)
            _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
            first = first[inverse.reshape(-1)]
            places.append(positions)
            vertices.append(faces + V)
            points.append(first[faces] + V)
            a, b, c = (positions.astype(np.float64) - positions.mean(0))[faces].swapaxes(0, 1)
            outward &= bool((a * np.cross(b, c)).sum() >= 0)  # six times the volume inside
            before = N
            if mesh.has_face_normals():
                normals.append(np.repeat(np.arange(len(faces))[:, None] + N, 3, axis=1))
                N += len(faces)
            else:
                back = _is_back(first[faces])
                shared = shared_normals(mesh, faces, first)[faces]
                normals.append(shared + N + len(positions) * back[:, None])
                N += len(positions) * (1 + back.any())
            V += len(positions)
            flips.append(np.full(N - before, points_inward(mesh, faces)))
        joined = (np.concatenate(x) for x in (places, vertices, points, normals, flips))
        return _Corners(*joined, V, N, outward)


def _is_back(points: np.ndarray) -> np.ndarray:
    """Return whether faces (F, 3) repeat an earlier face in the opposite winding, (F,).

    The backs of a sheet have their own normals, which would cancel the normals of its front.
    """
    start = points.argmin(axis=1)[:, None]
    a, b, c = (np.take_along_axis(points, (start + k) % 3, axis=1)[:, 0] for k in range(3))
    rows = np.concatenate([np.stack(x, axis=1) for x in ((a, b, c), (a, c, b))])
    kind = np.unique(rows, axis=0, return_inverse=True)[1].reshape(2, -1)
    first, face = np.full(kind.max(initial=0) + 1, len(points)), np.arange(len(points))
    np.minimum.at(first, kind[0], face)
    return first[kind[1]] < face


def _columns(array: np.ndarray, of: type | None = None) -> tuple:
    """Split an array (n, k) into Mitsuba's arrays (n,), ``mi.UInt32`` unless ``of`` is another."""
    of = of or mi.UInt32
    return tuple(of(np.ascontiguousarray(column)) for column in array.T)


def _edges(corners: _Corners, sides_of_faces: Sides) -> dict[str, object]:
    """Return the fields of edges, from the sides of faces as :func:`live_sides` finds them."""
    ends, live, owner = sides_of_faces
    tail, head = np.arange(3), np.array([1, 2, 0])
    points = corners.points
    sides = np.stack([points[:, tail], points[:, head]], axis=-1).reshape(-1, 2)  # (3F, 2)
    forward = sides[:, 0] < sides[:, 1]
    # A face with two corners at one place has a side of no length.
    has_length = live & (sides[:, 0] != sides[:, 1])
    key = sides.min(axis=1) * (points.max() + 1) + sides.max(axis=1)
    key = np.where(has_length, key, -1)
    order = np.argsort(key, kind="stable")
    order = order[key[order] >= 0]
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    counts = np.diff(begins, append=len(order))

    def at_ends(numbers: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return a numbering of corners at both ends of sides, the lower point first."""
        face, k = side // 3, side % 3
        pair = np.stack([numbers[face, k], numbers[face, head[k]]], axis=1)
        return np.where(forward[side][:, None], pair, pair[:, ::-1])

    first = order[begins]
    faces, runs = [], []
    crease = np.zeros(len(begins), bool)
    for k in range(counts.max(initial=1)):
        side = order[begins + np.minimum(k, counts - 1)]
        side = np.where(k < counts, side, first)
        faces.append(owner[side])
        runs.append(ends[side, 0] < ends[side, 1])
        differs = at_ends(corners.normals, side) != at_ends(corners.normals, first)
        crease |= differs.any(axis=1) | (owner[side] != side // 3)
    vertices = at_ends(corners.vertices, first)
    return {
        "ends": _columns(vertices),
        "end_points": _columns(at_ends(points, first)),
        "edge_faces": _columns(np.stack(faces, axis=1)),
        "edge_runs": _columns(np.stack(runs, axis=1), mi.Bool),
        "crease": mi.Bool(crease),
        "is_closed": bool((counts == 2).all()) and corners.outward,
        "ends_of_vertex": Segments.by_owner(vertices.reshape(-1), corners.V),
    }
