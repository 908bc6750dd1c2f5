"""Topology of meshes: corners, normals, edges and faces.

Built with numpy for the meshes of a scene; the arrays are Mitsuba's. It follows from the faces,
from :class:`Welds` and from the faces without area. These are compared for every image, and the
topology is built again when one of them has changed: no image depends on the images before it.

Names and sizes: ``V`` vertices of all meshes one after the other, ``F`` faces, ``E`` edges, ``N``
shading normals; corner ``k`` of face ``f`` is corner ``3 f + k``.

Three numberings of a corner:

* *vertex*: the entry in the vertex buffer, which carries position and gradient;
* *point*: vertices of one mesh at the same place are one point. Files split vertices along texture
  seams; an edge between split vertices is no border until they move apart;
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
memory uninitialised; when vertices move, it replaces those of the file as well. Then copies of a
smooth mesh belong together unless they differ by about a right angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.segment_sums import Segments

# Height of a face, as a share of its greatest coordinate, up to which it has no area. Chosen: four
# times float32's rounding, 2^-24.
AREA_ROUNDING = 2.0**-22


class _Sides(NamedTuple):
    """The sides of all faces: side ``k`` of face ``f`` is ``3 f + k``."""

    ends: np.ndarray  # (3F, 2) points at the ends, in the order in which the face runs
    live: np.ndarray  # (3F,) whether it belongs to an edge
    owner: np.ndarray  # (3F,) the face that it is a side of


def _live_sides(points: np.ndarray, flat: np.ndarray, longest: np.ndarray) -> _Sides:
    """Find the sides of faces (side ``k`` of face ``f`` is ``3 f + k``) that belong to edges.

    Faces have ``points`` (F, 3); the faces ``flat`` (n,) have no area. ``longest`` are the longest
    sides of those with three corners, in falling order of length.
    """
    owner, live = np.arange(points.size) // 3, np.ones(points.size, bool)
    ends = np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2)
    live[(3 * flat[:, None] + np.arange(3)).ravel()] = False
    if len(longest) == 0:
        return _Sides(ends, live, owner)
    edge = [tuple(side) for side in np.sort(ends, axis=1).tolist()]
    at: dict[tuple[int, int], list[int]] = {}  # live sides of each edge
    for side in np.flatnonzero(live).tolist():
        at.setdefault(edge[side], []).append(side)
    for long in longest.tolist():
        beyond = at.get(edge[long], [])
        if len(beyond) != 1:
            continue
        (side,) = beyond
        live[side], at[edge[long]] = False, []
        for other in (long - long % 3 + (long + j) % 3 for j in (1, 2)):
            if (ends[long] == ends[side]).all():  # the flat face is wound the other way
                ends[other] = ends[other, ::-1]
            live[other], owner[other] = True, owner[side]
            at.setdefault(edge[other], []).append(other)
    return _Sides(ends, live, owner)


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


def _shared_normals(mesh: mi.Mesh, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
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
    copies = np.bincount(points)
    order = np.argsort(points, kind="stable")
    order = order[copies[points[order]] > 1]
    for step in range(1, copies.max()):
        later, earlier = order[step:], order[:-step]
        joined = (points[later] == points[earlier]) & (
            (normals[later] * normals[earlier]).sum(1) > least
        )
        share[later[joined]] = earlier[joined]
    while (share[share] != share).any():
        share = share[share]
    return share


def _points_inward(mesh: mi.Mesh, faces: np.ndarray) -> bool:
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


def _unit(v: np.ndarray, axis: int = -1) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=axis, keepdims=True), SMALLEST_LENGTH)


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
    corners = positions.T[:, faces.T]  # (axis, corner, F)
    sides = _unit(np.roll(corners, -1, axis=1) - corners, axis=0)
    n = _unit(np.cross(sides[:, 0], sides[:, 1], axis=0), axis=0)
    angles = np.arccos(np.clip(-(sides * np.roll(sides, 1, axis=1)).sum(0), -1, 1))
    total = [np.bincount(faces.T.ravel(), (x * angles).ravel(), len(positions)) for x in n]
    return _unit(np.stack(total, axis=1))


class _MeshKey(NamedTuple):
    """What identifies a mesh and its faces, wherever the vertices are."""

    registered: int  # number in Mitsuba's registry of shapes
    buffer: int  # index of the faces' buffer
    vertex_count: int
    facets: bool  # each face has a normal of its own


@dataclass(frozen=True, eq=False)
class Welds:
    """Which vertices of a mesh are one, and which way its normals point.

    Example:
        A cube has three vertices at each corner, with a normal each.

        >>> welds = Welds.of(mi.load_dict({"type": "cube"}), earlier={})
        >>> len(np.unique(welds.points)), len(np.unique(welds.normals))
        (8, 24)
    """

    key: _MeshKey
    buffer: mi.UInt32  # the faces; kept, so that no other buffer gets its index
    faces: np.ndarray  # (F, 3) vertices
    points: np.ndarray  # (V,) the first vertex at each vertex's place
    normals: np.ndarray  # (V,) the vertex whose shading normal it shares
    inward: bool  # normals point against the winding

    @staticmethod
    def of(mesh: mi.Mesh, earlier: Mapping[_MeshKey, Welds]) -> Welds:
        """Read a mesh as it is now; return its ``earlier`` object if that still holds."""
        registered = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))[0]
        buffer, count, facets = mesh.faces_buffer(), mesh.vertex_count(), mesh.has_face_normals()
        key = _MeshKey(registered, buffer.index, count, facets)
        known = earlier.get(key)
        faces = np.array(buffer).reshape(-1, 3).astype(np.int64) if known is None else known.faces
        positions = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
        points = _first_at_place(positions, None if known is None else known.points)
        normals = points if facets else _shared_normals(mesh, faces, points)
        found = Welds(key, buffer, faces, points, normals, _points_inward(mesh, faces))
        return known if known is not None and found._agrees(known) else found

    def _agrees(self, other: Welds) -> bool:
        same = np.array_equal(self.points, other.points) and self.inward == other.inward
        return same and np.array_equal(self.normals, other.normals)


# Odd factors without a pattern, chosen: the sum of a place's bits times these is its hash.
HASH_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def _first_at_place(positions: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """Return the first vertex at the place of each vertex, (V,); ``known`` itself if it is that.

    Vertices that are known to be one must still be so, and there must be as many places as before.
    Hashes count the places in a fiftieth of the time of ``np.unique``.
    """
    if known is not None and (positions == positions[known]).all():
        bits = (positions + 0.0).view(np.uint32).astype(np.uint64)  # 0 in the place of -0
        places = np.count_nonzero(np.diff(np.sort(bits @ HASH_FACTORS))) + 1
        if places == np.count_nonzero(known == np.arange(len(known))):
            return known
    _, first, place = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    return first[place.reshape(-1)]


NO_FACES = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Topology:
    """The part of the meshes that most often stays the same while their vertices move.

    Example:
        >>> topology = Topology.of([Welds.of(mi.load_dict({"type": "cube"}), {})])
        >>> topology.face_count, topology.is_closed
        (12, True)
        >>> dr.width(topology.crease), dr.count(topology.crease)  # 6 edges are diagonals of sides
        (18, [12])
    """

    welds: tuple[Welds, ...]  # of each mesh
    first_face: mi.UInt32  # of the mesh with a given number in Mitsuba's registry of shapes
    flips: mi.Bool  # (N,) the normal points against the winding of its faces
    flat: np.ndarray  # (n,) faces without area, which belong to no edge
    longest: np.ndarray  # (m,) the longest sides of those with three corners, longest first
    vertices: tuple[mi.UInt32, ...]  # three (F,): vertex of each corner
    points: tuple[mi.UInt32, ...]  # three (F,): point of each corner
    normals: tuple[mi.UInt32, ...]  # three (F,): normal of each corner
    ends: tuple[mi.UInt32, ...]  # two (E,): vertices at the ends of an edge
    end_points: tuple[mi.UInt32, ...]  # two (E,): points at the ends of an edge
    edge_faces: tuple[mi.UInt32, ...]  # K of (E,): faces at an edge, the first repeated to fill up
    # K of (E,): whether that face runs from the edge's first end to its second
    edge_runs: tuple[mi.Bool, ...]
    is_closed: bool  # every edge has two faces
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
        return sum(mesh.key.vertex_count for mesh in self.welds)

    def face_number(self, shape: mi.ShapePtr, primitive: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return face numbers (R,) from Mitsuba's shape and primitive numbers; 0 if not active."""
        shape = dr.reinterpret_array(mi.UInt32, shape)
        first = dr.gather(mi.UInt32, self.first_face, shape, active)
        return dr.select(active, first + primitive, 0)

    @staticmethod
    def of(
        welds: Sequence[Welds], flat: np.ndarray = NO_FACES, longest: np.ndarray = NO_FACES
    ) -> Topology:
        """Find the edges between the faces of meshes.

        ``flat`` (n,) are further faces without area, and ``longest`` the longest sides of those
        with three corners, longest first; faces with two corners at one place are found.
        """
        corners = _Corners.of(welds)
        vertices, normals, V, N = corners.vertices, corners.normals, corners.V, corners.N
        repeated = (corners.points == np.roll(corners.points, 1, axis=1)).any(1)
        flat = np.union1d(flat, np.flatnonzero(repeated))
        corners_of_normal = Segments.by_owner(normals.reshape(-1), N)
        return Topology(
            welds=tuple(welds),
            first_face=_first_faces(welds),
            flips=mi.Bool(corners.flips),
            flat=flat,
            longest=longest,
            vertices=_columns(vertices),
            points=_columns(corners.points),
            normals=_columns(normals),
            corners_of_vertex=Segments.by_owner(vertices.reshape(-1), V),
            corners_of_point=Segments.by_owner(corners.points.reshape(-1), V),
            corners_of_normal=corners_of_normal,
            faces_of_normal=Segments(corners_of_normal.start, corners_of_normal.items // 3),
            **_edges(corners, _live_sides(corners.points, flat, longest)),
        )


def _first_faces(welds: Sequence[Welds]) -> mi.UInt32:
    """Return the number of each mesh's first face, by its number in Mitsuba's registry."""
    registry = [mesh.key.registered for mesh in welds]
    first = np.zeros(max(registry) + 1, np.uint32)
    first[registry] = np.cumsum([0, *(len(mesh.faces) for mesh in welds[:-1])])
    return mi.UInt32(first)


@dataclass(frozen=True)
class _Corners:
    """The three numberings of the corners of all meshes."""

    vertices: np.ndarray  # (F, 3)
    points: np.ndarray  # (F, 3)
    normals: np.ndarray  # (F, 3)
    flips: np.ndarray  # (N,) bool
    V: int
    N: int

    @staticmethod
    def of(welds: Sequence[Welds]) -> _Corners:
        vertices, points, normals, flips = [], [], [], []
        V, N = 0, 0
        for mesh in welds:
            faces, count = mesh.faces, mesh.key.vertex_count
            vertices.append(faces + V)
            points.append(mesh.points[faces] + V)
            before = N
            if mesh.key.facets:
                normals.append(np.repeat(np.arange(len(faces))[:, None] + N, 3, axis=1))
                N += len(faces)
            else:
                back = _is_back(mesh.points[faces])
                normals.append(mesh.normals[faces] + N + count * back[:, None])
                N += count * (1 + back.any())
            V += count
            flips.append(np.full(N - before, mesh.inward))
        joined = (np.concatenate(x) for x in (vertices, points, normals, flips))
        return _Corners(*joined, V, N)


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


def _edges(corners: _Corners, sides_of_faces: _Sides) -> dict[str, object]:
    """Return the fields of edges, from the sides of faces as :func:`_live_sides` finds them."""
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
        "is_closed": bool((counts == 2).all()),
        "ends_of_vertex": Segments.by_owner(vertices.reshape(-1), corners.V),
    }
