"""Lines in which surfaces pierce one another: where the image jumps though no edge is there.

An arm pressed into a belly meets it in a line; on its two sides one sees two surfaces, with other
normals. The line is a chain of segments, one for each pair of faces ``f, g`` that cut one another
(:mod:`gva_mi_plugins.mesh_normals.triangle_cuts`):

1. A point ``x`` of the segment lies in both planes. As the vertices move, with ``c`` the planes'
   normals and ``dx_f = Σ_k β_k dv_k`` the motion of ``f`` at ``x`` (``β`` barycentric), the segment
   passes ``x + dx`` with ``c_f · dx = c_f · dx_f`` and ``c_g · dx = c_g · dx_g``; along itself it
   may slide.
2. The lever ``(∂q/∂x)ᵀ m`` of :mod:`gva_mi_plugins.mesh_normals.contours` is across the segment, hence
   ``A c_f + B c_g``, and the image changes by ``ΔI (A c_f · dx_f + B c_g · dx_g) dℓ``.
3. On either side one sees the face that is nearer there. Along a step ``d`` across the line, seen
   on a ray ``r``, the nearness of a face rises by ``c · d / c · r``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.channels import Channels
from gva_mi_plugins.mesh_normals.contours import Cast, jump_between, on_image
from gva_mi_plugins.mesh_normals.projection import Projection
from gva_mi_plugins.mesh_normals.segment_sums import sum_by_key
from gva_mi_plugins.mesh_normals.surface import Surface
from gva_mi_plugins.mesh_normals.triangle_cuts import Cuts

IN_FRONT = 1e-4  # what hides a point lies nearer than it by more than this share of its depth
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
        cuts = Cuts.of(scene, surface)
        if cuts is None:
            return None
        f, g, start, end = cuts.f, cuts.g, cuts.start, cuts.end
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
        found = cast(q)
        # A ray to a line between faces that lie flat to one another may meet their neighbours.
        nothing_before = found.depth > projection.depth(x) * (1 - IN_FRONT)
        seen = (found.face == f) | (found.face == g) | nothing_before
        seen &= projection.is_inside(q) & found.hit

        cf, cg = (dr.gather(mi.Vector3f, surface.face_normals, face) for face in (f, g))
        # Eq. 3. Rays beside the line could not tell faces that lie flat to one another.
        step, toward = projection.sideways(across), projection.toward(x)
        rise_f, rise_g = (dr.dot(c, step) / dr.dot(c, toward) for c in (cf, cg))
        f_is_outside = rise_f > rise_g
        inner, outer = (
            replace(found, face=dr.select(f_is_outside, *faces)) for faces in ((g, f), (f, g))
        )
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
        """Eq. 2 forward: what samples carry as the positions (V,) move, for each channel (S,)."""
        motion = sum(
            dr.dot(lever, dr.gather(mi.Vector3f, d_positions, vertex))
            for vertex, lever in zip(self.vertices, self.levers, strict=True)
        )
        return [jump * motion for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Eq. 2 backward: from the gradients by what samples carry to that by positions (V,)."""
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


def _barycentric(
    x: mi.Vector3f, p0: mi.Vector3f, p1: mi.Vector3f, p2: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Coordinates of a point in the plane of a triangle."""
    c = dr.cross(p1 - p0, p2 - p0)
    c = c / dr.squared_norm(c)
    b1 = dr.dot(dr.cross(x - p0, p2 - p0), c)
    b2 = dr.dot(dr.cross(p1 - p0, x - p0), c)
    return 1 - b1 - b2, b1, b2
