"""Find the segments in which triangles intersect.

1. **Pairs**: of two triangles that cut one another, an edge of one passes through the other in
   either end of their segment, and a ray along that edge finds it. Where edges pass through edges,
   as all do where a leg is pressed against its mirror image, a ray meets any of the triangles at
   that place; so all around the one that it meets are candidates.
2. **Segments**: a triangle ``f`` meets the plane of ``g`` between those two of its sides whose ends
   lie on either side of it, and so does ``g`` that of ``f``. Both stretches lie on the line common
   to the planes; the segment is what they share. A side ends below a plane or not below it, there
   is no third case: at two sides or none. Segments shrink to nothing, and never break off, as
   triangles come to touch in a corner or an edge. This is done in float64.

Triangles with a side in common meet in it and nowhere else, and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.surface import MeshSurface
from gva_mi_plugins.mesh_normals.topology import Topology

CROSSINGS = 6  # hits that a ray along an edge looks for, triangles at its own ends included
STEP = 1e-4  # of an edge's length: what a ray leaves out at its ends and behind a hit
SHORT = 1e-9  # share of two triangles' stretches below which what they share is rounding


@dataclass(frozen=True)
class TriangleCuts:
    """Segments in which pairs of triangles cut one another."""

    f: mi.UInt32  # (R,) the first triangle of the pair
    g: mi.UInt32  # (R,) the second
    start: mi.Vector3f  # (R,) world
    end: mi.Vector3f  # (R,)

    @staticmethod
    def of(scene: mi.Scene, surface: MeshSurface) -> TriangleCuts | None:
        """Find all segments of the meshes of a scene; None where there are none."""
        edges, faces = _crossings(scene, surface)
        f, g = _pairs(surface.topology, edges, faces)
        if len(f) == 0:
            return None
        positions = np.array(surface.positions, np.float64).T
        vertices = np.stack([np.array(vertex) for vertex in surface.topology.vertices], axis=1)
        cut, start, end = shared_segments(positions[vertices[f]], positions[vertices[g]])
        if not cut.any():
            return None
        vector = lambda x: mi.Vector3f(np.ascontiguousarray(x.T.astype(np.float32)))
        number = lambda x: mi.UInt32(x[cut].astype(np.uint32))
        return TriangleCuts(number(f), number(g), vector(start), vector(end))


def shared_segments(f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 2 for pairs of triangles f and g, (C, 3, 3).

    Returns:
        Which pairs cut one another, (C,) bool, and the ends of their segments, (R, 3) each.
    """
    normal = lambda p: np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    nf, ng = normal(f), normal(g)
    above_g = np.einsum("ckx,cx->ck", f - g[:, :1], ng)
    above_f = np.einsum("ckx,cx->ck", g - f[:, :1], nf)
    cut = np.ones(len(f), bool)
    for below in (above_g < 0, above_f < 0):
        cut &= below.any(1) & ~below.all(1)
    line = np.cross(nf, ng)[cut]
    stretches = [_crossed(p[cut], above[cut]) for p, above in ((f, above_g), (g, above_f))]
    along = [np.einsum("rex,rx->re", ends, line) for ends in stretches]
    order = [np.argsort(x, axis=1) for x in along]
    along = [np.take_along_axis(x, o, 1) for x, o in zip(along, order, strict=True)]
    stretches = [
        np.take_along_axis(x, o[..., None], 1) for x, o in zip(stretches, order, strict=True)
    ]
    (f0, f1), (g0, g1) = (x.T for x in along)
    long = np.minimum(f1, g1) - np.maximum(f0, g0) > SHORT * (f1 - f0 + g1 - g0)
    start = np.where((f0 > g0)[:, None], stretches[0][:, 0], stretches[1][:, 0])
    end = np.where((f1 < g1)[:, None], stretches[0][:, 1], stretches[1][:, 1])
    cut[cut] = long
    return cut, start[long], end[long]


def _crossed(corners: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Return where triangles (R, 3, 3) meet a plane: points on two of their sides, (R, 2, 3).

    ``above`` (R, 3) are heights of the corners over the plane, of both signs in each row.
    """
    below = above < 0
    row, side = np.nonzero(below != np.roll(below, -1, axis=1))  # two in each row
    other = (side + 1) % 3
    t = above[row, side] / (above[row, side] - above[row, other])
    a, b = corners[row, side], corners[row, other]
    return (a + t[:, None] * (b - a)).reshape(-1, 2, 3)


def _crossings(scene: mi.Scene, surface: MeshSurface) -> tuple[np.ndarray, np.ndarray]:
    """Find the edges (X,) that pass through a triangle, and those triangles (X,)."""
    topology = surface.topology
    A, B = (dr.gather(mi.Vector3f, surface.positions, end) for end in topology.ends)
    edge = dr.arange(mi.UInt32, dr.width(topology.crease))
    t = dr.full(mi.Float, STEP, dr.width(edge))
    edges, faces = [np.zeros(0, np.uint32)], [np.zeros(0, np.uint32)]
    for _ in range(CROSSINGS):
        a, along = dr.gather(mi.Vector3f, A, edge), dr.gather(mi.Vector3f, B - A, edge)
        ray = mi.Ray3f(mi.Point3f(a + t * along), along)
        ray.maxt = 1 - STEP - t
        found = scene.ray_intersect_preliminary(ray, coherent=False)
        hit = found.is_valid()
        face = topology.face_number(found.shape, found.prim_index, hit)
        own = _touches(topology, face, edge)
        t = t + found.t + STEP
        dr.eval(hit, own, face, t)
        active = dr.compress(hit)
        if dr.width(active) == 0:
            break
        own, face, edge, t = (dr.gather(type(v), v, active) for v in (own, face, edge, t))
        crosses = ~np.array(own)
        edges.append(np.array(edge)[crosses])
        faces.append(np.array(face)[crosses])
    return np.concatenate(edges).astype(np.int64), np.concatenate(faces).astype(np.int64)


def _touches(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Whether a face has a corner at an end of an edge."""
    ends = [dr.gather(mi.UInt32, end, edge) for end in topology.end_points]
    touches = mi.Bool(False)
    for corner in topology.points:
        point = dr.gather(mi.UInt32, corner, face)
        touches |= (point == ends[0]) | (point == ends[1])
    return touches


def _pairs(
    topology: Topology, edges: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 1: find triangles that may cut one another, each pair once, (C,) and (C,)."""
    points = np.stack([np.array(corner) for corner in topology.points], axis=1).astype(np.int64)
    start, items = (
        np.array(x).astype(np.int64)
        for x in (topology.corners_of_point.start, topology.corners_of_point.items)
    )
    around = points[faces].reshape(-1)
    count = start[around + 1] - start[around]
    which = np.repeat(np.arange(len(around)), count)
    entry = np.arange(len(which)) + np.repeat(start[around] - np.cumsum(count) + count, count)
    near, edge = items[entry] // 3, edges[which // 3]
    keys = []
    for at_edge in topology.edge_faces:
        own = np.array(at_edge).astype(np.int64)[edge]
        keys.append(np.minimum(own, near) * topology.face_count + np.maximum(own, near))
    key = np.unique(np.concatenate(keys))
    f, g = key // topology.face_count, key % topology.face_count
    shared = (points[f][:, :, None] == points[g][:, None]).any(2).sum(1)
    return f[shared < 2], g[shared < 2]
