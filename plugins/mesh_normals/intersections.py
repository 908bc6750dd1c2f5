"""Boundary term of the derivative where surfaces intersect: the image jumps without an edge.

An arm pressed into a belly meets it in a line; on its two sides one sees two surfaces, with
different normals. The line is a chain of segments, one for each pair of faces ``f, g`` that cut one
another (``triangle_cuts.py``):

1. A point ``x`` of the segment lies in both planes. As the vertices move, with ``c`` the planes'
   normals and ``dx_f = Σ_k β_k dv_k`` the motion of ``f`` at ``x`` (``β`` barycentric), the segment
   passes ``x + dx`` with ``c_f · dx = c_f · dx_f`` and ``c_g · dx = c_g · dx_g``; along itself it
   may slide.
2. A part of it sweeps over the area ``sweep · dx`` of the image, ``sweep = (∂q/∂x)ᵀ m dℓ`` as in
   ``contours.py``. This vector is across the segment, hence ``A c_f + B c_g``, and the image
   changes by ``ΔI (A c_f · dx_f + B c_g · dx_g)``.
3. On either side one sees the face that is nearer there. Along a step ``d`` across the line, seen
   on a ray ``r``, the nearness of a face rises by ``c · d / c · r``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.projection import SensorProjection, share_on_segment
from gva_mi_plugins.mesh_normals.rays import RayCaster, RayHits
from gva_mi_plugins.mesh_normals.segment_sums import sum_by_key
from gva_mi_plugins.mesh_normals.triangle_cuts import TriangleCuts

IN_FRONT = 1e-4  # what hides a point lies nearer than it by more than this share of its depth
FLAT = 1e-6  # sin² of the angle between two planes below which their line has no direction


@dataclass(frozen=True)
class Intersections:
    """Samples on the lines that one view sees, each with the jump of the image across it."""

    vertex_count: int  # V
    vertices: list[mi.UInt32]  # six (S,): corners of f and g
    sweeps: list[mi.Vector3f]  # six (S,), eq. 2 by the corners: A β_k c_f and B β_k c_g
    q: mi.Point2f  # (S,) pixels; (0, 0) where the line is not seen
    jump: list[mi.Float]  # ΔI of each channel, (S,); zero where the line is not seen

    @staticmethod
    def of(caster: RayCaster, density: float) -> Intersections | None:
        """Sample the visible lines, ``density`` points a pixel of length; None if none is seen."""
        surface, projection = caster.surface, caster.projection
        cuts = TriangleCuts.of(caster.scene, surface)
        samples = None if cuts is None else _sample(cuts, projection, density)
        if samples is None:
            return None
        hits = caster.cast(samples.q)
        # A ray to a line between faces that lie flat to one another may meet their neighbours.
        nothing_before = hits.depth > projection.depth(samples.x) * (1 - IN_FRONT)
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
        """Eq. 2 forward: the samples' contributions, per channel (S,), as positions (V,) move."""
        area = sum(
            dr.dot(sweep, dr.gather(mi.Vector3f, d_positions, vertex))
            for vertex, sweep in zip(self.vertices, self.sweeps, strict=True)
        )
        return [jump * area for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Eq. 2 backward: from gradients by the contributions to that by positions (V,)."""
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
    across: mi.Vector2f  # (S,) m times the segment's length on the image, pixels
    step: mi.Vector2f  # (S,) m times the part's


def _sample(
    cuts: TriangleCuts, projection: SensorProjection, density: float
) -> _LineSamples | None:
    """Samples on the parts of segments that lie on the image; None where there are none."""
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
    """Eq. 3: what is seen against and along ``across``. Rays beside the line could not tell faces
    that lie flat to one another."""
    step, toward = projection.sideways(samples.across), projection.toward(samples.x)
    rise_f, rise_g = (dr.dot(c, step) / dr.dot(c, toward) for c in (cf, cg))
    f_is_outside = rise_f > rise_g
    f, g = samples.f, samples.g
    inner, outer = (dr.select(f_is_outside, *faces) for faces in ((g, f), (f, g)))
    return replace(hits, face=inner), replace(hits, face=outer)


def _along_normals(
    sweep: mi.Vector3f, cf: mi.Vector3f, cg: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Eq. 2: the factors ``A, B`` of ``sweep = A c_f + B c_g``, and whether they are determined."""
    ff, gg, fg = dr.dot(cf, cf), dr.dot(cg, cg), dr.dot(cf, cg)
    sf, sg = dr.dot(sweep, cf), dr.dot(sweep, cg)
    determinant = ff * gg - fg * fg
    A = (sf * gg - sg * fg) / determinant
    B = (sg * ff - sf * fg) / determinant
    return A, B, determinant > FLAT * ff * gg


def _barycentric(
    x: mi.Vector3f, p0: mi.Vector3f, p1: mi.Vector3f, p2: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Coordinates of a point in the plane of a triangle."""
    c = dr.cross(p1 - p0, p2 - p0)
    c = c / dr.squared_norm(c)
    b1 = dr.dot(dr.cross(x - p0, p2 - p0), c)
    b2 = dr.dot(dr.cross(p1 - p0, x - p0), c)
    return 1 - b1 - b2, b1, b2
