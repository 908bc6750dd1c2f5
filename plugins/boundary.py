"""The boundary term: what an image gains and loses where edges sweep over it.

Inside a region the image ``I`` of a surface changes smoothly with the vertices. Across an edge seen
by the camera it jumps by ``ΔI = I_inside - I_outside``, and a moving edge carries the jump along:

1. ``∂I/∂v = Σ_edges ∫ ΔI (m · ∂q/∂v) dℓ`` over the points ``q`` of the edge on the image, with
   ``m`` its normal there, from inside to outside, and ``ℓ`` its length in pixels.
2. The integral is a sum over samples in the middle of K equal parts of the edge, each with the
   weight ``|edge| / K``.
3. At parameter ``t`` on the image an edge from ``a`` to ``b``, at depths ``w_a`` and ``w_b``, shows
   the world point ``x = (1 - s) a + s b`` with ``s = t w_a / (t w_a + (1 - t) w_b)``; hence
   ``∂x/∂a = 1 - s`` and ``∂x/∂b = s``.

Edges that can show a jump: **contours**, whose faces all lie on one side of them on the image (a
fold seen from the front, and any border of an open mesh), and **creases**, where two faces do not
share a normal. Two rays a hair's breadth beside the edge tell ``I_inside``, ``I_outside``, and
whether the edge is seen at all. At a contour the inner one must hit a face that touches the edge
(its own one may be seen so flat that the ray leaps over it), and the outer one nothing in front of
it; at a crease both must hit the faces of the edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.projection import Projection
from gva_mi_plugins.segments import sum_by_key, sum_runs
from gva_mi_plugins.surface import Surface
from gva_mi_plugins.topology import Topology

BESIDE = 5e-4  # pixels from an edge to the rays beside it: far above float32's step there
IN_FRONT = 1e-3  # what hides an edge lies nearer than it by more than this share of its depth

Cast = Callable[[mi.Ray3f], tuple[mi.UInt32, mi.Float, mi.Bool]]  # face, depth and whether it hit


@dataclass(frozen=True)
class Boundary:
    """Samples on the edges that one view sees, each with the jump of the image across it."""

    surface: Surface
    projection: Projection
    edge: mi.UInt32  # (S,) which edge a sample lies on
    edges: mi.UInt32  # (R,) the edges that have samples
    start: mi.UInt32  # (R,) the first sample of each
    s: mi.Float  # (S,) eq. 3
    pixel: mi.UInt32  # (S,) the pixel a sample falls into
    lever: mi.Vector3f  # (S,) (∂q/∂x)ᵀ m |edge| / K
    jump: mi.Vector4f  # (S,) ΔI, zero where the edge is not seen

    @staticmethod
    def of(
        surface: Surface, projection: Projection, cast: Cast, density: float, near: float
    ) -> Boundary | None:
        """Sample the edges seen; None where there are none.

        Args:
            surface: the meshes.
            projection: the camera.
            cast: shoots rays at them.
            density: samples for a pixel of length.
            near: edges with an end nearer than this depth are left out.
        """
        topology = surface.topology
        pixel, depth = projection.pixel(surface.positions)
        corner = dr.gather(mi.Vector3f, surface.positions, topology.vertices[0])
        turns = dr.dot(surface.face_normals, corner - projection.eye) > 0
        dr.eval(pixel, depth, turns)

        a, b = (dr.gather(mi.Point2f, pixel, end) for end in topology.ends)
        wa, wb = (dr.gather(mi.Float, depth, end) for end in topology.ends)
        on_left = [
            dr.gather(mi.Bool, turns, face) == runs
            for face, runs in zip(topology.edge_faces, topology.edge_runs, strict=True)
        ]
        contour = mi.Bool(True)
        for side in on_left[1:]:
            contour &= side == on_left[0]
        lower, upper = dr.minimum(a, b), dr.maximum(a, b)
        on_image = (upper.x > 0) & (upper.y > 0)
        on_image &= (lower.x < projection.width) & (lower.y < projection.height)
        dr.eval(contour)
        edges = dr.compress((contour | topology.crease) & on_image & (wa > near) & (wb > near))
        if dr.width(edges) == 0:
            return None

        along = dr.gather(mi.Vector2f, mi.Vector2f(b - a), edges)
        longest = 2.0 * (projection.width + projection.height)
        length = dr.minimum(dr.norm(along), longest)
        count = mi.UInt32(dr.maximum(dr.ceil(length * density), 1))
        start = dr.prefix_sum(count)
        total = dr.sum(count)[0]
        first_of_edge = dr.zeros(mi.UInt32, total)
        dr.scatter(first_of_edge, mi.UInt32(1), start)
        run = dr.prefix_sum(first_of_edge) + first_of_edge - 1
        dr.eval(run, start, count)

        edge, count = dr.gather(mi.UInt32, edges, run), mi.Float(dr.gather(mi.UInt32, count, run))
        t = (dr.arange(mi.UInt32, total) - dr.gather(mi.UInt32, start, run) + 0.5) / count
        a, b, wa, wb = (dr.gather(type(x), x, edge) for x in (a, b, wa, wb))
        q = dr.lerp(a, b, t)
        s = t * wa / (t * wa + (1 - t) * wb)
        w = dr.lerp(wa, wb, s)
        across = mi.Vector2f(b.y - a.y, a.x - b.x)
        across = dr.select(dr.gather(mi.Bool, on_left[0], edge), across, -across)
        beside = BESIDE * across / dr.maximum(dr.norm(across), 1e-9)

        inner, outer = projection.ray(q - beside), projection.ray(q + beside)
        inner_face, _, inner_hits = cast(inner)
        outer_face, outer_depth, outer_hits = cast(outer)
        seen = projection.is_inside(q) & inner_hits
        is_contour = dr.gather(mi.Bool, contour, edge)
        at_contour = _touches(topology, inner_face, edge)
        at_contour &= ~outer_hits | (outer_depth > w * (1 - IN_FRONT))
        at_crease = outer_hits & _owns(topology, inner_face, edge)
        at_crease &= _owns(topology, outer_face, edge)
        seen &= dr.select(is_contour, at_contour, at_crease)
        outer_hits &= seen
        n = surface.shade(inner, inner_face, seen) - surface.shade(outer, outer_face, outer_hits)
        n = projection.camera_world @ n
        jump = dr.select(seen, mi.Vector4f(n.x, n.y, n.z, dr.select(outer_hits, 0, 1)), 0)
        lever = projection.pull_back(across / count, q, w)
        pixel = dr.select(seen, projection.pixel_index(q), 0)
        dr.eval(edge, s, pixel, lever, jump)
        return Boundary(surface, projection, edge, edges, start, s, pixel, lever, jump)

    def tangent(self, d_positions: mi.Vector3f) -> tuple[list[mi.Vector4f], mi.UInt32]:
        """Eq. 1 forward: how pixels change with the positions (V,), and which ones do."""
        ends = [dr.gather(mi.UInt32, end, self.edge) for end in self.surface.topology.ends]
        da, db = (dr.gather(mi.Vector3f, d_positions, end) for end in ends)
        d_image = self.jump * dr.dot(self.lever, dr.lerp(da, db, self.s))
        dr.eval(d_image)
        (sums,), pixels = sum_by_key([d_image], self.pixel)
        return sums, pixels

    def adjoint(self, grad_image: mi.Vector4f) -> mi.Vector3f:
        """Eq. 1 backward: from the gradient by the pixels (H W,) to that by the positions (V,)."""
        topology = self.surface.topology
        grad = dr.dot(dr.gather(mi.Vector4f, grad_image, self.pixel), self.jump)
        grad_x = self.lever * grad
        by_end = (grad_x * (1 - self.s), grad_x * self.s)
        dr.eval(by_end)
        at_ends = dr.zeros(mi.Vector3f, 2 * dr.width(topology.crease))
        for k, value in enumerate(by_end):
            dr.scatter(
                at_ends, sum_runs(value, self.start, dr.width(self.edge)), 2 * self.edges + k
            )
        dr.eval(at_ends)
        return topology.ends_of_vertex.sum(at_ends)


def _touches(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Whether a face has a corner at an end of an edge."""
    ends = [dr.gather(mi.UInt32, end, edge) for end in topology.end_points]
    touches = mi.Bool(False)
    for corner in topology.points:
        point = dr.gather(mi.UInt32, corner, face)
        touches |= (point == ends[0]) | (point == ends[1])
    return touches


def _owns(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Whether an edge is a side of a face."""
    owns = mi.Bool(False)
    for edge_face in topology.edge_faces:
        owns |= face == dr.gather(mi.UInt32, edge_face, edge)
    return owns
