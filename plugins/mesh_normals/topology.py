"""What meshes are made of beside positions: corners, shared normals, edges and faces.

Built once for the meshes of a scene, with numpy; the arrays are Mitsuba's. Names and sizes: ``V``
vertices of all meshes one after the other, ``F`` faces, ``E`` edges, ``N`` shading normals; corner
``k`` of face ``f`` is corner ``3 f + k``.

Three numberings of a corner:

* *vertex*: the entry in the vertex buffer, which carries position and gradient;
* *point*: vertices of one mesh at the same place are one point. Files split vertices along texture
  seams; an edge between split vertices is no border, and must not count as one;
* *normal*: corners that share a shading normal. A smooth mesh has one for each vertex, a faceted
  one for each face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.segment_sums import Segments


@dataclass(frozen=True)
class Topology:
    """Everything of the meshes that stays while their vertices move."""

    vertex_counts: tuple[int, ...]  # of each mesh
    first_face: mi.UInt32  # of the mesh with a given number in Mitsuba's registry of shapes
    mesh_of_face: mi.UInt32  # (F,) number of the mesh that a face belongs to, from 0
    normal_count: int  # N
    vertices: tuple[mi.UInt32, ...]  # three (F,): vertex of each corner
    points: tuple[mi.UInt32, ...]  # three (F,): point of each corner
    normals: tuple[mi.UInt32, ...]  # three (F,): normal of each corner
    ends: tuple[mi.UInt32, ...]  # two (E,): vertices at the ends of an edge
    end_points: tuple[mi.UInt32, ...]  # two (E,): points at the ends of an edge
    edge_faces: tuple[mi.UInt32, ...]  # K of (E,): faces at an edge, the first repeated to fill up
    edge_runs: tuple[
        mi.Bool, ...
    ]  # K of (E,): that face runs from the edge's first end to its second
    is_closed: bool  # every edge has two faces
    crease: mi.Bool  # (E,): the normal jumps here even between two faces seen from the front
    corners_of_vertex: Segments  # V segments over the 3F corners
    corners_of_point: Segments  # V segments over the 3F corners
    corners_of_normal: Segments  # N segments over the 3F corners
    faces_of_normal: Segments  # N segments over the F faces
    ends_of_vertex: Segments  # V segments over the 2E ends (end k of edge e is 2 e + k)

    @property
    def face_count(self) -> int:
        """F."""
        return dr.width(self.vertices[0])

    @property
    def vertex_count(self) -> int:
        """V."""
        return sum(self.vertex_counts)


def build(meshes: Sequence[mi.Mesh]) -> Topology:
    """Read the faces of the meshes and find the edges between them."""
    vertices, points, normals = [], [], []
    face_counts = [mesh.face_count() for mesh in meshes]
    V = F = N = 0
    registry = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))[0] for mesh in meshes]
    first_face = np.zeros(max(registry) + 1, np.uint32)
    for mesh, number in zip(meshes, registry, strict=True):
        first_face[number] = F
        positions = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
        faces = np.array(mesh.faces_buffer()).reshape(-1, 3).astype(np.int64)
        _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
        vertices.append(faces + V)
        points.append(first[inverse.reshape(-1)][faces] + V)
        if mesh.has_face_normals():
            normals.append(np.repeat(np.arange(len(faces))[:, None] + N, 3, axis=1))
            N += len(faces)
        else:
            normals.append(faces + N)
            N += len(positions)
        V, F = V + len(positions), F + len(faces)
    vertices, points, normals = (np.concatenate(x) for x in (vertices, points, normals))
    ends, end_points, edge_faces, runs, crease, is_closed = _edges(vertices, points, normals)
    corners_of_normal = Segments.by_owner(normals.reshape(-1), N)
    columns = lambda array: tuple(mi.UInt32(np.ascontiguousarray(column)) for column in array.T)
    return Topology(
        vertex_counts=tuple(mesh.vertex_count() for mesh in meshes),
        first_face=mi.UInt32(first_face),
        mesh_of_face=mi.UInt32(np.repeat(np.arange(len(meshes)), face_counts).astype(np.uint32)),
        normal_count=N,
        vertices=columns(vertices),
        points=columns(points),
        normals=columns(normals),
        ends=columns(ends),
        end_points=columns(end_points),
        edge_faces=columns(edge_faces),
        edge_runs=tuple(mi.Bool(np.ascontiguousarray(column)) for column in runs.T),
        is_closed=is_closed,
        crease=mi.Bool(crease),
        corners_of_vertex=Segments.by_owner(vertices.reshape(-1), V),
        corners_of_point=Segments.by_owner(points.reshape(-1), V),
        corners_of_normal=corners_of_normal,
        faces_of_normal=Segments(corners_of_normal.start, corners_of_normal.items // 3),
        ends_of_vertex=Segments.by_owner(ends.reshape(-1), V),
    )


def _edges(vertices: np.ndarray, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, ...]:
    """Edges: ends (E, 2), their points (E, 2), faces (E, K), runs (E, K), crease (E,);
    and whether all have two faces."""
    tail, head = np.arange(3), np.array([1, 2, 0])
    sides = np.stack([points[:, tail], points[:, head]], axis=-1).reshape(-1, 2)  # (3F, 2)
    forward = sides[:, 0] < sides[:, 1]
    kept = (
        sides[:, 0] != sides[:, 1]
    )  # a face with two corners at one place has a side of no length
    key = np.where(kept, sides.min(axis=1) * (points.max() + 1) + sides.max(axis=1), -1)
    order = np.argsort(key, kind="stable")
    order = order[key[order] >= 0]
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    counts = np.diff(begins, append=len(order))

    def at_ends(numbers: np.ndarray, side: np.ndarray) -> np.ndarray:
        """A numbering of corners at both ends of some sides, the lower point first."""
        face, k = side // 3, side % 3
        pair = np.stack([numbers[face, k], numbers[face, head[k]]], axis=1)
        return np.where(forward[side][:, None], pair, pair[:, ::-1])

    first = order[begins]
    faces, runs = [], []
    crease = np.zeros(len(begins), bool)
    for k in range(counts.max(initial=1)):
        side = order[begins + np.minimum(k, counts - 1)]
        side = np.where(k < counts, side, first)
        faces.append(side // 3)
        runs.append(forward[side])
        crease |= (at_ends(normals, side) != at_ends(normals, first)).any(axis=1)
    return (
        at_ends(vertices, first),
        at_ends(points, first),
        np.stack(faces, axis=1),
        np.stack(runs, axis=1),
        crease,
        bool((counts == 2).all()),
    )
