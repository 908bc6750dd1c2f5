"""Lines in which surfaces pierce one another: where the image jumps though no edge is there.

An arm pressed into a belly meets it in a line; on its two sides one sees two surfaces, with other
normals. The line is a chain of segments, one for each pair of faces ``f, g`` that cut one another:

1. An edge of ``f`` that passes through ``g``, or one of ``g`` through ``f``, does so in an end of
   their segment. A ray along every edge finds them all.
2. A point ``x`` of the segment lies in both planes. As the vertices move, with ``c`` the planes'
   normals and ``dx_f = Σ_k β_k dv_k`` the motion of ``f`` at ``x`` (``β`` barycentric), the segment
   passes ``x + dx`` with ``c_f · dx = c_f · dx_f`` and ``c_g · dx = c_g · dx_g``; along itself it
   may slide.
3. The lever ``(∂q/∂x)ᵀ m`` of :mod:`gva_mi_plugins.boundary` is across the segment, hence
   ``A c_f + B c_g``, and the image changes by ``ΔI (A c_f · dx_f + B c_g · dx_g) dℓ``.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.boundary import BESIDE, Cast, jump_between, on_image, touches
from gva_mi_plugins.channels import Channels
from gva_mi_plugins.projection import Projection
from gva_mi_plugins.segments import sum_by_key
from gva_mi_plugins.surface import Surface
from gva_mi_plugins.topology import Topology

CROSSINGS = 6  # hits that a ray along an edge looks for, faces at its own ends included
STEP = 1e-4  # of an edge's length: what a ray leaves out at its ends and behind a hit
FLAT = 1e-6  # sin² of the angle between two planes below which their line has no direction


@dataclass(frozen=True)
class Piercing:
    """Samples on the lines that one view sees, each with the jump of the image across it."""

    vertex_count: int  # V
    vertices: list[mi.UInt32]  # six (S,): corners of f and g
    levers: list[mi.Vector3f]  # six (S,): A β_k c_f and B β_k c_g, times the length of the sample
    q: mi.Point2f  # (S,) pixels; (0, 0) where the line is not seen
    jump: list[mi.Float]  # ΔI of each channel, (S,); zero where the line is not seen

    @staticmethod
    def of(
        scene: mi.Scene,
        surface: Surface,
        projection: Projection,
        channels: Channels,
        cast: Cast,
        density: float,
    ) -> Piercing | None:
        """Sample the lines seen; None where there are none.

        Args:
            scene: holds the meshes.
            surface: the meshes.
            projection: the camera.
            channels: of the image.
            cast: shoots rays from the camera at the meshes.
            density: samples for a pixel of length.
        """
        found = _segments(surface.topology, *_crossings(scene, surface))
        if found is None:
            return None
        f, g, start, end = found
        (a, ha), (b, hb) = projection.pixel(start), projection.pixel(end)
        t0, t1 = on_image(a, b, projection.width, projection.height)
        near = dr.minimum(projection.depth(start), projection.depth(end))
        length = dr.select((t1 > t0) & (near > projection.near), dr.norm(b - a) * (t1 - t0), 0)
        counts = np.ceil(np.array(length * density)).astype(np.int64)
        if not counts.any():
            return None

        run = np.repeat(np.arange(len(counts)), counts)
        part = (np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[
            run
        ]
        run, part, count = mi.UInt32(run), mi.Float(part), mi.Float(counts[run])
        f, g, a, b, ha, hb, t0, t1, start, end = (
            dr.gather(type(x), x, run) for x in (f, g, a, b, ha, hb, t0, t1, start, end)
        )
        t = dr.lerp(t0, t1, part)
        q = dr.lerp(a, b, t)
        s = t * ha / (t * ha + (1 - t) * hb)
        x, h = dr.lerp(start, end, s), dr.lerp(ha, hb, s)
        across = mi.Vector2f(b.y - a.y, a.x - b.x)
        beside = BESIDE * across / dr.maximum(dr.norm(across), 1e-9)
        inner, outer = cast(q - beside), cast(q + beside)
        seen = projection.is_inside(q) & inner.hit & outer.hit
        seen &= ((inner.face == f) & (outer.face == g)) | ((inner.face == g) & (outer.face == f))

        cf, cg = (dr.gather(mi.Vector3f, surface.face_normals, face) for face in (f, g))
        lever = projection.pull_back(across * (t1 - t0) / count, q, h)
        ff, gg, fg = dr.dot(cf, cf), dr.dot(cg, cg), dr.dot(cf, cg)
        lf, lg = dr.dot(lever, cf), dr.dot(lever, cg)
        determinant = ff * gg - fg * fg
        seen &= determinant > FLAT * ff * gg
        A = (lf * gg - lg * fg) / determinant
        B = (lg * ff - lf * fg) / determinant
        jump = jump_between(surface, projection, channels, inner, outer, seen)
        vertices, levers = [], []
        for face, push in ((f, A * cf), (g, B * cg)):
            corners = [dr.gather(mi.UInt32, vertex, face) for vertex in surface.topology.vertices]
            p = [dr.gather(mi.Vector3f, surface.positions, vertex) for vertex in corners]
            vertices += corners
            levers += [dr.select(seen, beta * push, 0) for beta in _barycentric(x, *p)]
        q = dr.select(seen, q, 0)
        dr.eval(vertices, levers, q, jump)
        return Piercing(surface.topology.vertex_count, vertices, levers, q, jump)

    def tangent(self, d_positions: mi.Vector3f) -> list[mi.Float]:
        """Eq. 3 forward: what samples carry as the positions (V,) move, for each channel (S,)."""
        motion = sum(
            dr.dot(lever, dr.gather(mi.Vector3f, d_positions, vertex))
            for vertex, lever in zip(self.vertices, self.levers, strict=True)
        )
        return [jump * motion for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Eq. 3 backward: from the gradients by what samples carry to that by positions (V,)."""
        grad = sum(g * jump for g, jump in zip(grads, self.jump, strict=True))
        count = dr.width(grad)
        by_corner = dr.zeros(mi.Vector3f, 6 * count)
        vertex = dr.zeros(mi.UInt32, 6 * count)
        for k, (corner, lever) in enumerate(zip(self.vertices, self.levers, strict=True)):
            index = 6 * dr.arange(mi.UInt32, count) + k
            dr.scatter(by_corner, lever * grad, index)
            dr.scatter(vertex, corner, index)
        dr.eval(by_corner, vertex)
        (sums,), vertices = sum_by_key([by_corner], vertex)
        result = dr.zeros(mi.Vector3f, self.vertex_count)
        dr.scatter(result, sums, vertices)
        return result


def _crossings(scene: mi.Scene, surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 1: edges that pass through a face (C,), those faces (C,), and where, (C, 3)."""
    topology = surface.topology
    A, B = (dr.gather(mi.Vector3f, surface.positions, end) for end in topology.ends)
    edge = dr.arange(mi.UInt32, dr.width(topology.crease))
    t = dr.full(mi.Float, STEP, dr.width(edge))
    edges, faces, points = [], [], []
    for _ in range(CROSSINGS):
        a, along = dr.gather(mi.Vector3f, A, edge), dr.gather(mi.Vector3f, B - A, edge)
        ray = mi.Ray3f(mi.Point3f(a + t * along), along)
        ray.maxt = 1 - STEP - t
        found = scene.ray_intersect_preliminary(ray, coherent=False)
        hit = found.is_valid()
        shape = dr.reinterpret_array(mi.UInt32, found.shape)
        face = dr.gather(mi.UInt32, topology.first_face, shape, hit) + found.prim_index
        face = dr.select(hit, face, 0)
        own = touches(topology, face, edge)
        x = a + (t + found.t) * along
        t = t + found.t + STEP
        dr.eval(hit, own, face, x, t)
        active = dr.compress(hit)
        if dr.width(active) == 0:
            break
        own, face, x, edge, t = (dr.gather(type(v), v, active) for v in (own, face, x, edge, t))
        crosses = ~np.array(own)
        edges.append(np.array(edge)[crosses])
        faces.append(np.array(face)[crosses])
        points.append(np.array(x).T[crosses])
    if not edges:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
    return np.concatenate(edges), np.concatenate(faces), np.concatenate(points)


def _segments(
    topology: Topology, edges: np.ndarray, faces: np.ndarray, points: np.ndarray
) -> tuple[mi.UInt32, mi.UInt32, mi.Vector3f, mi.Vector3f] | None:
    """Join the ends: faces f, g (R,) that cut one another, and the ends (R,) of their segments.

    A pair that shares a corner has its segment's other end there, and no ray finds it; those
    segments, in the folds of one surface, are left out.
    """
    if len(edges) == 0:
        return None
    at_edge = np.stack([np.array(face)[edges] for face in topology.edge_faces], axis=1)
    fresh = np.stack(
        [(at_edge[:, :k] != at_edge[:, k : k + 1]).all(1) for k in range(at_edge.shape[1])], axis=1
    )
    which, slot = np.nonzero(fresh)
    f, g, x = at_edge[which, slot].astype(np.int64), faces[which].astype(np.int64), points[which]
    key = np.minimum(f, g) * topology.face_count + np.maximum(f, g)
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    first = first[np.diff(first, append=len(key)) == 2]
    if len(first) == 0:
        return None
    start, end = x[order[first]], x[order[first + 1]]
    vector = lambda v: mi.Vector3f(np.ascontiguousarray(v.T))
    pair = key[first]
    return (
        mi.UInt32(pair // topology.face_count), mi.UInt32(pair % topology.face_count),
        vector(start), vector(end),
    )  # fmt: skip


def _barycentric(
    x: mi.Vector3f, p0: mi.Vector3f, p1: mi.Vector3f, p2: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Coordinates of a point in the plane of a triangle."""
    c = dr.cross(p1 - p0, p2 - p0)
    c = c / dr.squared_norm(c)
    b1 = dr.dot(dr.cross(x - p0, p2 - p0), c)
    b2 = dr.dot(dr.cross(p1 - p0, x - p0), c)
    return 1 - b1 - b2, b1, b2
