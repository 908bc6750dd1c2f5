"""The boundary term: what an image gains and loses where edges sweep over it.

Inside a region the image ``I`` of a surface changes smoothly with the vertices. Across an edge seen
by the camera it jumps by ``ΔI = I_inside - I_outside``, and a moving edge carries the jump along:

1. ``∂I/∂v = Σ_edges ∫ ΔI (m · ∂q/∂v) dℓ`` over the points ``q`` of the edge on the image, with
   ``m`` its normal there, from inside to outside, and ``ℓ`` its length in pixels.
2. The integral is a sum over samples in the middle of K equal parts of the edge, each with the
   weight ``|edge| / K``.
3. At parameter ``t`` on the image an edge from ``a`` to ``b``, seen at the scales ``h_a`` and
   ``h_b``, shows the world point ``x = (1 - s) a + s b``, ``s = t h_a / (t h_a + (1 - t) h_b)``;
   hence ``∂x/∂a = 1 - s`` and ``∂x/∂b = s``.

Edges are cut at the near plane and at the border of the image first: ``t`` runs over what is left.

Edges that can show a jump: **contours**, whose faces all lie on one side of them on the image (a
fold seen from the front, and any border of an open mesh), and **creases**, where two faces do not
share a normal. Two rays a hair's breadth beside the edge tell ``I_inside``, ``I_outside``, and
whether the edge is seen at all. At a contour the inner one must hit a face of the edge, or one that
shares a corner with it and does not reach over the edge (its own one may be seen so flat that the
ray leaps over it), and the outer one nothing in front of it; at a crease both must hit the faces of
the edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.channels import Channels
from gva_mi_plugins.mesh_normals.projection import Projection
from gva_mi_plugins.mesh_normals.segment_sums import sum_runs
from gva_mi_plugins.mesh_normals.surface import Surface
from gva_mi_plugins.mesh_normals.topology import Topology

BESIDE = 5e-4  # pixels from an edge to the rays beside it: far above float32's step there
IN_FRONT = 1e-3  # what hides an edge lies nearer than it by more than this share of its depth


@dataclass(frozen=True)
class Found:
    """What rays meet."""

    ray: mi.Ray3f  # (R,)
    face: mi.UInt32  # (R,) 0 where nothing is hit
    depth: mi.Float  # (R,)
    hit: mi.Bool  # (R,)


Cast = Callable[[mi.Point2f], Found]  # from positions in pixels


@dataclass(frozen=True)
class Boundary:
    """Samples on the edges that one view sees, each with the jump of the image across it."""

    topology: Topology
    edge: mi.UInt32  # (S,) which edge a sample lies on
    edges: mi.UInt32  # (R,) the edges that have samples
    start: mi.UInt32  # (R,) the first sample of each
    s: mi.Float  # (S,) eq. 3
    q: mi.Point2f  # (S,) pixels; (0, 0) where the edge is not seen
    lever: mi.Vector3f  # (S,) (∂q/∂x)ᵀ m |edge| / K
    jump: list[mi.Float]  # ΔI of each channel, (S,); zero where the edge is not seen

    @staticmethod
    def of(
        surface: Surface, projection: Projection, channels: Channels, cast: Cast, density: float
    ) -> Boundary | None:
        """Sample the edges seen; None where there are none.

        Args:
            surface: the meshes.
            projection: the camera.
            channels: of the image.
            cast: shoots rays at the meshes.
            density: samples for a pixel of length.
        """
        topology = surface.topology
        corner = dr.gather(mi.Vector3f, surface.positions, topology.vertices[0])
        turns = dr.dot(surface.face_normals, projection.toward(corner)) > 0
        depth = projection.depth(surface.positions)
        dr.eval(turns, depth)
        on_left = [
            dr.gather(mi.Bool, turns, face) == runs
            for face, runs in zip(topology.edge_faces, topology.edge_runs, strict=True)
        ]
        contour = mi.Bool(True)
        for side in on_left[1:]:
            contour &= side == on_left[0]

        wa, wb = (dr.gather(mi.Float, depth, end) for end in topology.ends)
        at_near = (projection.near - wa) / (wb - wa)
        s0 = dr.select(wa < projection.near, at_near, 0)
        s1 = dr.select(wb < projection.near, at_near, 1)
        A, B = (dr.gather(mi.Vector3f, surface.positions, end) for end in topology.ends)
        (a, ha), (b, hb) = (projection.pixel(dr.lerp(A, B, s)) for s in (s0, s1))
        t0, t1 = on_image(a, b, projection.width, projection.height)
        in_front = (wa > projection.near) | (wb > projection.near)
        dr.eval(contour, a, b, ha, hb, s0, s1, t0, t1)
        edges = dr.compress((contour | topology.crease) & in_front & (t1 > t0))
        if dr.width(edges) == 0:
            return None

        ends = [dr.gather(mi.Point2f, point, edges) for point in (a, b)]
        share = dr.gather(mi.Float, t1, edges) - dr.gather(mi.Float, t0, edges)
        length = dr.norm(ends[1] - ends[0]) * share
        count = mi.UInt32(dr.maximum(dr.ceil(length * density), 1))
        start = dr.prefix_sum(count)
        total = dr.sum(count)[0]
        first_of_edge = dr.zeros(mi.UInt32, total)
        dr.scatter(first_of_edge, mi.UInt32(1), start)
        run = dr.prefix_sum(first_of_edge) + first_of_edge - 1
        dr.eval(run, start, count)

        edge, count = dr.gather(mi.UInt32, edges, run), mi.Float(dr.gather(mi.UInt32, count, run))
        part = (dr.arange(mi.UInt32, total) - dr.gather(mi.UInt32, start, run) + 0.5) / count
        a, b, ha, hb, s0, s1, t0, t1, wa, wb = (
            dr.gather(type(x), x, edge) for x in (a, b, ha, hb, s0, s1, t0, t1, wa, wb)
        )
        t = dr.lerp(t0, t1, part)
        q = dr.lerp(a, b, t)
        s = t * ha / (t * ha + (1 - t) * hb)
        h = dr.lerp(ha, hb, s)
        s = dr.lerp(s0, s1, s)
        across = mi.Vector2f(b.y - a.y, a.x - b.x)
        across = dr.select(dr.gather(mi.Bool, on_left[0], edge), across, -across)
        beside = BESIDE * across / dr.maximum(dr.norm(across), 1e-9)

        inner, outer = cast(q - beside), cast(q + beside)
        is_contour = dr.gather(mi.Bool, contour, edge)
        w = dr.lerp(wa, wb, s)
        hidden = _covers(surface, projection.ray(q), inner.face, w - projection.near)
        at_contour = _owns(topology, inner.face, edge)
        at_contour |= _adjoins(topology, inner.face, edge) & ~hidden
        at_contour &= ~outer.hit | (outer.depth > w * (1 - IN_FRONT))
        at_crease = outer.hit & _owns(topology, inner.face, edge)
        at_crease &= _owns(topology, outer.face, edge)
        seen = projection.is_inside(q) & inner.hit & dr.select(is_contour, at_contour, at_crease)
        jump = jump_between(surface, projection, channels, inner, outer, seen)
        q = dr.select(seen, q, 0)
        lever = dr.select(seen, projection.pull_back(across * (t1 - t0) / count, q, h), 0)
        dr.eval(edge, s, q, lever, jump)
        return Boundary(topology, edge, edges, start, s, q, lever, jump)

    def tangent(self, d_positions: mi.Vector3f) -> list[mi.Float]:
        """Eq. 1 forward: what samples carry as the positions (V,) move, for each channel (S,)."""
        ends = [dr.gather(mi.UInt32, end, self.edge) for end in self.topology.ends]
        da, db = (dr.gather(mi.Vector3f, d_positions, end) for end in ends)
        motion = dr.dot(self.lever, dr.lerp(da, db, self.s))
        return [jump * motion for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Eq. 1 backward: from the gradients by what samples carry to that by positions (V,)."""
        grad_x = self.lever * sum(g * jump for g, jump in zip(grads, self.jump, strict=True))
        by_end = (grad_x * (1 - self.s), grad_x * self.s)
        dr.eval(by_end)
        at_ends = dr.zeros(mi.Vector3f, 2 * dr.width(self.topology.crease))
        for k, value in enumerate(by_end):
            dr.scatter(
                at_ends, sum_runs(value, self.start, dr.width(self.edge)), 2 * self.edges + k
            )
        dr.eval(at_ends)
        return self.topology.ends_of_vertex.sum(at_ends)


def jump_between(
    surface: Surface,
    projection: Projection,
    channels: Channels,
    inner: Found,
    outer: Found,
    seen: mi.Bool,
) -> list[mi.Float]:
    """ΔI = I_inside - I_outside of each channel; zero where not seen."""
    sides = []
    for side in (inner, outer):
        hit = side.hit & seen
        n, t = surface.shade(side.ray, side.face, hit)
        sides.append(channels.values(n, t + projection.near, hit, projection.camera_world))
    return [dr.select(seen, inside - outside, 0) for inside, outside in zip(*sides, strict=True)]


def on_image(a: mi.Point2f, b: mi.Point2f, width: int, height: int) -> tuple[mi.Float, mi.Float]:
    """Where the line from ``a`` to ``b`` enters and leaves the image; it is empty for t0 >= t1."""
    t0, t1 = mi.Float(0), mi.Float(1)
    for k, size in enumerate((width, height)):
        step = b[k] - a[k]
        at_low, at_high = -a[k] / step, (size - a[k]) / step
        level = dr.abs(step) < 1e-6
        outside = level & ((a[k] < 0) | (a[k] > size))
        t0 = dr.maximum(t0, dr.select(level, 0, dr.minimum(at_low, at_high)))
        t1 = dr.minimum(t1, dr.select(level, 1, dr.maximum(at_low, at_high)))
        t1 = dr.select(outside, 0, t1)
    return t0, t1


def _adjoins(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Whether a face shares a corner with a face of an edge."""
    adjoins = mi.Bool(False)
    for edge_face in topology.edge_faces:
        own = dr.gather(mi.UInt32, edge_face, edge)
        mine = [dr.gather(mi.UInt32, corner, own) for corner in topology.points]
        for corner in topology.points:
            point = dr.gather(mi.UInt32, corner, face)
            adjoins |= (point == mine[0]) | (point == mine[1]) | (point == mine[2])
    return adjoins


def _covers(surface: Surface, ray: mi.Ray3f, face: mi.UInt32, t: mi.Float) -> mi.Bool:
    """Whether rays meet a face before their parameter ``t``."""
    corners = [dr.gather(mi.UInt32, vertex, face) for vertex in surface.topology.vertices]
    p = [dr.gather(mi.Vector3f, surface.positions, vertex) for vertex in corners]
    e1, e2, s = p[1] - p[0], p[2] - p[0], mi.Vector3f(ray.o) - p[0]
    h, k = dr.cross(ray.d, e2), dr.cross(s, e1)
    det = dr.dot(e1, h)
    b1, b2 = dr.dot(s, h) / det, dr.dot(ray.d, k) / det
    return (b1 > 0) & (b2 > 0) & (b1 + b2 < 1) & (dr.dot(e2, k) / det < t)


def _owns(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Whether an edge is a side of a face."""
    owns = mi.Bool(False)
    for edge_face in topology.edge_faces:
        owns |= face == dr.gather(mi.UInt32, edge_face, edge)
    return owns
