"""Boundary term of the derivative where surfaces intersect: the image jumps without an edge.

An arm pressed into a belly meets it in a line. On its two sides two surfaces with different normals
are visible. The line is a chain of segments, one for each pair of intersecting faces ``f, g``
(4, 5):

1. A point ``x`` of the segment lies in both planes. Let ``c`` be the planes' normals and ``dx_f =
   Σ_k β_k dv_k`` the motion of ``f`` at ``x`` (``β`` barycentric). As the vertices move, the
   segment passes through ``x + dx`` with ``c_f · dx = c_f · dx_f`` and ``c_g · dx = c_g · dx_g``.
   Its motion along itself is free.
2. A part of it sweeps over the area ``sweep · dx`` of the image, ``sweep = (∂q/∂x)ᵀ m dℓ`` as in
   ``contours.py``. This vector is perpendicular to the segment, so it equals ``A c_f + B c_g``, and
   the image changes by ``ΔI (A c_f · dx_f + B c_g · dx_g)``.
3. On either side the face that is nearer there is visible. Along a step ``d`` across the line, seen
   on a ray ``r``, the nearness of a face rises by ``c · d / c · r``.
4. **Pairs**: where two triangles intersect, an edge of one passes through the other at either end
   of their segment, and a ray along that edge finds it. Where a leg is pressed against its mirror
   image, edges pass through edges, and the ray may meet any of the triangles at that place.
   Therefore all triangles around the one that it meets are candidates.
5. **Segments**: the triangle ``f`` meets the plane of ``g`` between the two of its sides whose ends
   lie on either side of that plane, and ``g`` meets the plane of ``f`` likewise. Both stretches lie
   on the line common to the planes; the segment is their common part. An end counts as below a
   plane or as not below it, so a triangle has two such sides or none. Then segments shrink to
   nothing, and never end abruptly, as triangles come to touch in a corner or an edge. This is the
   interval test of Möller, "A Fast Triangle-Triangle Intersection Test", 1997, in float64.

Triangles with a common side meet only in it, and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.projection import SensorProjection, share_on_segment
from gva_mi_plugins.mesh_normals.rays import RayCaster, RayHits
from gva_mi_plugins.mesh_normals.segment_sums import sum_by_key
from gva_mi_plugins.mesh_normals.surface import MeshSurface
from gva_mi_plugins.mesh_normals.topology import Topology

# Hits that a ray along an edge looks for, triangles at its own ends included. Chosen: the
# edge of a body's mesh seldom passes through more.
MOST_HITS = 6
# Share of an edge's length that a ray leaves out at its ends and behind a hit. Chosen: so that
# float32 does not find the same triangle again.
RAY_GAP = 1e-4
# Share of the stretches of two triangles below which their common part is rounding. Chosen for
# float64, whose rounding is 1e-16.
SHORTEST_SHARE = 1e-9


@dataclass(frozen=True)
class _TriangleCuts:
    """Segments in which pairs of triangles intersect."""

    f: mi.UInt32  # (R,) the first triangle of the pair
    g: mi.UInt32  # (R,) the second
    start: mi.Vector3f  # (R,) world
    end: mi.Vector3f  # (R,)

    @staticmethod
    def of(scene: mi.Scene, surface: MeshSurface) -> _TriangleCuts | None:
        """Find all segments of the meshes of a scene; None if there are none."""
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
        return _TriangleCuts(number(f), number(g), vector(start), vector(end))


def shared_segments(f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intersect pairs of triangles f and g, (C, 3, 3), by eq. 5.

    Returns:
        Whether each pair intersects, (C,) bool, and the ends of their segments, (R, 3) each.

    Example:
        >>> level = np.array([[[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]])
        >>> upright = np.array([[[0.5, 0.5, -1], [0.5, 0.5, 1], [0.5, 3.5, 0]]])
        >>> cut, start, end = shared_segments(level, upright)
        >>> cut, np.sort([start[0, 1], end[0, 1]])  # from y = 0.5 to the side x + y = 2
        (array([ True]), array([0.5, 1.5]))
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
    long = np.minimum(f1, g1) - np.maximum(f0, g0) > SHORTEST_SHARE * (f1 - f0 + g1 - g0)
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
    t = dr.full(mi.Float, RAY_GAP, dr.width(edge))
    edges, faces = [np.zeros(0, np.uint32)], [np.zeros(0, np.uint32)]
    for _ in range(MOST_HITS):
        a, along = dr.gather(mi.Vector3f, A, edge), dr.gather(mi.Vector3f, B - A, edge)
        ray = mi.Ray3f(mi.Point3f(a + t * along), along)
        ray.maxt = 1 - RAY_GAP - t
        found = scene.ray_intersect_preliminary(ray, coherent=False)
        hit = found.is_valid()
        face = topology.face_number(found.shape, found.prim_index, hit)
        touches = _touches(topology, face, edge)
        t = t + found.t + RAY_GAP
        dr.eval(hit, touches, face, t)
        active = dr.compress(hit)
        if dr.width(active) == 0:
            break
        touches, face, edge, t = (dr.gather(type(v), v, active) for v in (touches, face, edge, t))
        crosses = ~np.array(touches)
        edges.append(np.array(edge)[crosses])
        faces.append(np.array(face)[crosses])
    return np.concatenate(edges).astype(np.int64), np.concatenate(faces).astype(np.int64)


def _touches(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Return whether a face has a corner at an end of an edge."""
    ends = [dr.gather(mi.UInt32, end, edge) for end in topology.end_points]
    touches = mi.Bool(False)
    for corner in topology.points:
        point = dr.gather(mi.UInt32, corner, face)
        touches |= (point == ends[0]) | (point == ends[1])
    return touches


def _pairs(
    topology: Topology, edges: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find triangles that may intersect (eq. 4), each pair once, (C,) and (C,)."""
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
        beside = np.array(at_edge).astype(np.int64)[edge]
        keys.append(np.minimum(beside, near) * topology.face_count + np.maximum(beside, near))
    key = np.unique(np.concatenate(keys))
    f, g = key // topology.face_count, key % topology.face_count
    shared = (points[f][:, :, None] == points[g][:, None]).any(2).sum(1)
    return f[shared < 2], g[shared < 2]


# Share of a point's depth by which an occluder must lie nearer than it. Chosen: above float32's
# rounding of a depth.
OCCLUDER_MARGIN = 1e-4
# sin² of the angle between two planes below which their line has no direction. Chosen: about ten
# times float32's rounding, 6e-8, of the terms whose difference it is.
SMALLEST_SQUARED_SINE = 1e-6


@dataclass(frozen=True)
class Intersections:
    """Samples on the visible lines of one view, each with the jump of the image across it.

    Example:
        A cube turned by 45° stands half out of a wall: they meet in two upright lines, √2 m to its
        left and right, 4 m away.

        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> sensor = {"type": "perspective", "fov": 90, "film": film}  # a focal length of 8 px
        >>> at = mi.ScalarTransform4f
        >>> wall = {"type": "cube", "to_world": at().translate([0, 0, 5]).scale([3, 3, 1])}
        >>> cube = {"type": "cube", "to_world": at().translate([0, 0, 4]).rotate([0, 1, 0], 45)}
        >>> scene = {"type": "scene", "sensor": sensor, "wall": wall, "cube": cube}
        >>> scene = mi.load_dict(scene)
        >>> view = mi.load_dict({"type": "mesh_normals"}).view(scene, scene.sensors()[0])
        >>> lines = Intersections.of(view.caster, density=1)
        >>> dr.max(lines.q.x), dr.max(dr.abs(lines.jump[0]))  # 8 + 8 √2 / 4 px; sin 45°
        ([10.8284], [0.707107])
    """

    vertex_count: int  # V
    vertices: list[mi.UInt32]  # six (S,): corners of f and g
    sweeps: list[mi.Vector3f]  # six (S,), eq. 2 by the corners: A β_k c_f and B β_k c_g
    q: mi.Point2f  # (S,) pixels; (0, 0) where the line is not seen
    jump: list[mi.Float]  # ΔI of each channel, (S,); zero where the line is not seen

    @staticmethod
    def of(caster: RayCaster, density: float) -> Intersections | None:
        """Sample visible lines, ``density`` points per pixel of length; None if none is found."""
        surface, projection = caster.surface, caster.projection
        cuts = _TriangleCuts.of(caster.scene, surface)
        samples = None if cuts is None else _sample(cuts, projection, density)
        if samples is None:
            return None
        hits = caster.cast(samples.q)
        # A ray to a line between nearly parallel faces may meet their neighbours.
        nothing_before = hits.depth > projection.depth(samples.x) * (1 - OCCLUDER_MARGIN)
        seen = (hits.face == samples.f) | (hits.face == samples.g) | nothing_before
        seen &= projection.is_inside(samples.q) & hits.hit

        cf, cg = (
            dr.gather(mi.Vector3f, surface.face_normals, face) for face in (samples.f, samples.g)
        )
        inner, outer = _sides(samples, cf, cg, projection, hits)
        sweep = projection.pull_back(samples.step, samples.q, samples.h)
        A, B, has_direction = _along_normals(sweep, cf, cg)
        seen &= has_direction
        jump = caster.jump(inner, outer, seen)
        vertices, sweeps = [], []
        for face, push in ((samples.f, A * cf), (samples.g, B * cg)):
            vertices += surface.vertices_of(face)
            shares = _barycentric(samples.x, *surface.corners_of(face))
            sweeps += [dr.select(seen, beta * push, 0) for beta in shares]
        q = dr.select(seen, samples.q, 0)
        dr.eval(vertices, sweeps, q, jump)
        return Intersections(surface.topology.vertex_count, vertices, sweeps, q, jump)

    def tangent(self, d_positions: mi.Vector3f) -> list[mi.Float]:
        """Evaluate eq. 2 forward: contributions per channel (S,) of moving positions (V,)."""
        area = sum(
            dr.dot(sweep, dr.gather(mi.Vector3f, d_positions, vertex))
            for vertex, sweep in zip(self.vertices, self.sweeps, strict=True)
        )
        return [jump * area for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Evaluate eq. 2 backward: from gradients of contributions to gradients of positions."""
        grad = sum(g * jump for g, jump in zip(grads, self.jump, strict=True))
        count = dr.width(grad)
        by_corner = dr.zeros(mi.Vector3f, 6 * count)
        vertex = dr.zeros(mi.UInt32, 6 * count)
        for k, (corner, sweep) in enumerate(zip(self.vertices, self.sweeps, strict=True)):
            index = 6 * dr.arange(mi.UInt32, count) + k
            dr.scatter(by_corner, sweep * grad, index)
            dr.scatter(vertex, corner, index)
        dr.eval(by_corner, vertex)
        (sums,), vertices = sum_by_key([by_corner], vertex)
        result = dr.zeros(mi.Vector3f, self.vertex_count)
        dr.scatter(result, sums, vertices)
        return result


@dataclass(frozen=True)
class _LineSamples:
    """Samples in the middle of equal parts of segments."""

    f: mi.UInt32  # (S,) the one face
    g: mi.UInt32  # (S,) the other
    x: mi.Vector3f  # (S,) world
    q: mi.Point2f  # (S,) pixels
    h: mi.Float  # (S,) scale
    across: mi.Vector2f  # (S,) m times the length of the segment on the image, pixels
    step: mi.Vector2f  # (S,) m times the length of the sample's part, pixels


def _sample(
    cuts: _TriangleCuts, projection: SensorProjection, density: float
) -> _LineSamples | None:
    """Sample the parts of segments that lie on the image; None if there are none."""
    (a, ha), (b, hb) = projection.pixel(cuts.start), projection.pixel(cuts.end)
    t0, t1 = projection.clip(a, b)
    near = dr.minimum(projection.depth(cuts.start), projection.depth(cuts.end))
    length = dr.select((t1 > t0) & (near > projection.near), dr.norm(b - a) * (t1 - t0), 0)
    counts = np.ceil(np.array(length * density)).astype(np.int64)
    if not counts.any():
        return None
    run = np.repeat(np.arange(len(counts)), counts)
    before = np.repeat(np.cumsum(counts) - counts, counts)
    part = (np.arange(len(run)) - before + 0.5) / counts[run]
    run, part, count = mi.UInt32(run), mi.Float(part), mi.Float(counts[run])
    f, g, a, b, ha, hb, t0, t1, start, end = (
        dr.gather(type(x), x, run)
        for x in (cuts.f, cuts.g, a, b, ha, hb, t0, t1, cuts.start, cuts.end)
    )
    t = dr.lerp(t0, t1, part)
    s = share_on_segment(t, ha, hb)
    x, h = dr.lerp(start, end, s), dr.lerp(ha, hb, s)
    across = mi.Vector2f(b.y - a.y, a.x - b.x)
    return _LineSamples(f, g, x, dr.lerp(a, b, t), h, across, across * (t1 - t0) / count)


def _sides(
    samples: _LineSamples,
    cf: mi.Vector3f,
    cg: mi.Vector3f,
    projection: SensorProjection,
    hits: RayHits,
) -> tuple[RayHits, RayHits]:
    """Return the visible faces against and along ``across`` (eq. 3).

    Rays beside the line could not distinguish nearly parallel faces.
    """
    step, toward = projection.sideways(samples.across), projection.toward(samples.x)
    rise_f, rise_g = (dr.dot(c, step) / dr.dot(c, toward) for c in (cf, cg))
    f_is_outside = rise_f > rise_g
    f, g = samples.f, samples.g
    inner, outer = (dr.select(f_is_outside, *faces) for faces in ((g, f), (f, g)))
    return replace(hits, face=inner), replace(hits, face=outer)


def _along_normals(
    sweep: mi.Vector3f, cf: mi.Vector3f, cg: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Solve ``sweep = A c_f + B c_g`` (eq. 2): A, B, and whether they are determined."""
    ff, gg, fg = dr.dot(cf, cf), dr.dot(cg, cg), dr.dot(cf, cg)
    sf, sg = dr.dot(sweep, cf), dr.dot(sweep, cg)
    determinant = ff * gg - fg * fg
    A = (sf * gg - sg * fg) / determinant
    B = (sg * ff - sf * fg) / determinant
    return A, B, determinant > SMALLEST_SQUARED_SINE * ff * gg


def _barycentric(
    x: mi.Vector3f, p0: mi.Vector3f, p1: mi.Vector3f, p2: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Return the barycentric coordinates of a point in the plane of a triangle."""
    c = dr.cross(p1 - p0, p2 - p0)
    c = c / dr.squared_norm(c)
    b1 = dr.dot(dr.cross(x - p0, p2 - p0), c)
    b2 = dr.dot(dr.cross(p1 - p0, x - p0), c)
    return 1 - b1 - b2, b1, b2
