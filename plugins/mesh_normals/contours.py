"""Boundary term of the derivative at edges: the image changes where edges sweep over it.

Inside a region the image ``I`` of a surface changes smoothly with the vertices. Across a visible
edge it jumps by ``ΔI = I_inside - I_outside``, and the jump moves with the edge (Li et al.,
"Differentiable Monte Carlo Ray Tracing through Edge Sampling", 2018):

1. ``∂I/∂v = Σ_edges ∫ ΔI (m · ∂q/∂v) dℓ`` over the points ``q`` of the edge on the image, with
   ``m`` its normal there, from inside to outside, and ``ℓ`` its length in pixels.
2. The integral is approximated by samples in the middle of K equal parts of the edge, each with the
   weight ``|edge| / K``. As its point ``x`` moves, such a part sweeps over the area ``sweep · dx``
   with ``sweep = (∂q/∂x)ᵀ m |edge| / K``.
3. The point moves with the ends of its edge, ``x = (1 - s) a + s b``; hence ``∂x/∂a = 1 - s`` and
   ``∂x/∂b = s`` (``projection.py`` finds ``s`` from the place on the image).

Edges are cut at the near plane and at the border of the image first.

Two kinds of edges can show a jump. The faces of a **contour** all lie on one side of it on the
image: a fold, or any border of an open mesh. At a **crease** two faces do not share a normal. Two
rays very close to the edge, one on either side, find ``I_inside`` and ``I_outside``, and whether
the edge is visible. At a contour the outer ray must hit nothing in front of the edge. The inner ray
must hit a face of the edge, or a face that shares a corner with it and does not reach over the
edge, because the ray may miss a face of the edge that is seen edge-on. At a crease both rays must
hit faces of the edge.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.projection import SensorProjection, share_on_segment
from gva_mi_plugins.mesh_normals.rays import RayCaster, RayHits
from gva_mi_plugins.mesh_normals.segment_sums import sum_runs
from gva_mi_plugins.mesh_normals.surface import MeshSurface, meet_plane
from gva_mi_plugins.mesh_normals.topology import Topology

# Pixels from an edge to the two rays beside it. Chosen: above float32's spacing of pixel
# positions (6e-5 at 512), and so small that another edge seldom lies between.
EDGE_RAY_OFFSET = 5e-4
# Share of an edge's depth by which an occluder must lie nearer than it. Chosen: above float32's
# error of a hit on a face that is seen nearly edge-on.
OCCLUDER_MARGIN = 1e-3


@dataclass(frozen=True)
class Contours:
    """Samples on the visible edges of one view, each with the jump of the image across it.

    Example:
        A cube of 2 m, whose front is 4 m away, covers 4 x 4 pixels. It comes nearer by 1 m per unit
        of time: its area grows by 2 / 4 of itself.

        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> sensor = {"type": "perspective", "fov": 90, "film": film}  # a focal length of 8 px
        >>> cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 5])}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "cube": cube})
        >>> integrator = mi.load_dict({"type": "mesh_normals", "channels": "mask"})
        >>> caster = integrator.view(scene, scene.sensors()[0]).caster
        >>> nearer = dr.zeros(mi.Vector3f, caster.surface.topology.vertex_count) - [0, 0, 1]
        >>> dr.sum(Contours.of(caster, density=1).tangent(nearer)[0])
        [8]
    """

    topology: Topology
    edge: mi.UInt32  # (S,) the edge of each sample
    edges: mi.UInt32  # (R,) the edges that have samples
    start: mi.UInt32  # (R,) the first sample of each
    s: mi.Float  # (S,) eq. 3
    q: mi.Point2f  # (S,) pixels; (0, 0) where the edge is not seen
    sweep: mi.Vector3f  # (S,) eq. 2; zero where the edge is not seen
    jump: list[mi.Float]  # ΔI of each channel, (S,); zero where the edge is not seen

    @staticmethod
    def of(caster: RayCaster, density: float) -> Contours | None:
        """Sample visible edges, ``density`` points per pixel of length; None if none can jump."""
        topology, projection = caster.surface.topology, caster.projection
        on_image = _EdgesOnImage.of(caster.surface, projection)
        edges = dr.compress(on_image.can_jump)
        if dr.width(edges) == 0:
            return None
        start, samples = _sample(on_image, edges, density)
        beside = EDGE_RAY_OFFSET * samples.across / dr.maximum(dr.norm(samples.across), 1e-9)
        if caster.channels.moves_inside:
            inner, outer = caster.cast(samples.q - beside), caster.cast(samples.q + beside)
            seen = _is_seen(caster, samples, inner, outer)
            jump = caster.jump(inner, outer, seen)
        else:  # the mask jumps only at a contour before the background
            free = samples.is_contour & projection.is_inside(samples.q)
            free &= ~caster.meets(samples.q + beside)
            seen = free & _is_before(caster, samples, caster.cast(samples.q - beside, free))
            jump = [dr.select(seen, mi.Float(1), 0)]
        q = dr.select(seen, samples.q, 0)
        sweep = dr.select(seen, projection.pull_back(samples.step, q, samples.h), 0)
        dr.eval(samples.edge, samples.s, q, sweep, jump)
        return Contours(topology, samples.edge, edges, start, samples.s, q, sweep, jump)

    def tangent(self, d_positions: mi.Vector3f) -> list[mi.Float]:
        """Evaluate eq. 1 forward: contributions per channel (S,) of moving positions (V,)."""
        ends = [dr.gather(mi.UInt32, end, self.edge) for end in self.topology.ends]
        da, db = (dr.gather(mi.Vector3f, d_positions, end) for end in ends)
        area = dr.dot(self.sweep, dr.lerp(da, db, self.s))
        return [jump * area for jump in self.jump]

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Evaluate eq. 1 backward: from gradients of contributions to gradients of positions."""
        grad_x = self.sweep * sum(g * jump for g, jump in zip(grads, self.jump, strict=True))
        by_end = (grad_x * (1 - self.s), grad_x * self.s)
        dr.eval(by_end)
        at_ends = dr.zeros(mi.Vector3f, 2 * dr.width(self.topology.crease))
        for k, sums in enumerate(sum_runs(list(by_end), self.start, dr.width(self.edge))):
            dr.scatter(at_ends, sums, 2 * self.edges + k)
        dr.eval(at_ends)
        return self.topology.ends_of_vertex.sum(at_ends)


@dataclass(frozen=True)
class _EdgesOnImage:
    """Edges projected to the image, from ``a`` to ``b``, cut at the near plane."""

    is_contour: mi.Bool  # (E,) all faces lie on one side of it
    inside_is_left: mi.Bool  # (E,) the first face lies to the left of the way from a to b
    can_jump: mi.Bool  # (E,) it is a contour or a crease, and part of it lies on the image
    a: mi.Point2f  # (E,) pixels
    b: mi.Point2f  # (E,)
    ha: mi.Float  # (E,) scale of a
    hb: mi.Float  # (E,)
    s0: mi.Float  # (E,) share of the edge before a
    s1: mi.Float  # (E,) share of the edge before b
    t0: mi.Float  # (E,) where the way from a to b enters the image
    t1: mi.Float  # (E,) where it leaves the image
    wa: mi.Float  # (E,) depth of the edge's first end, before the cut
    wb: mi.Float  # (E,) depth of its second end

    @staticmethod
    def of(surface: MeshSurface, projection: SensorProjection) -> _EdgesOnImage:
        topology = surface.topology
        toward = projection.toward(surface.corners[0])
        turned_away = dr.dot(surface.face_normals, toward) > 0
        depth = projection.depth(surface.positions)
        dr.eval(turned_away, depth)
        on_left = [
            dr.gather(mi.Bool, turned_away, face) == runs
            for face, runs in zip(topology.edge_faces, topology.edge_runs, strict=True)
        ]
        is_contour = mi.Bool(True)
        for side in on_left[1:]:
            is_contour &= side == on_left[0]

        wa, wb = (dr.gather(mi.Float, depth, end) for end in topology.ends)
        at_near = (projection.near - wa) / (wb - wa)
        s0 = dr.select(wa < projection.near, at_near, 0)
        s1 = dr.select(wb < projection.near, at_near, 1)
        A, B = (dr.gather(mi.Vector3f, surface.positions, end) for end in topology.ends)
        (a, ha), (b, hb) = (projection.pixel(dr.lerp(A, B, s)) for s in (s0, s1))
        t0, t1 = projection.clip(a, b)
        in_front = (wa > projection.near) | (wb > projection.near)
        dr.eval(is_contour, a, b, ha, hb, s0, s1, t0, t1)
        can_jump = (is_contour | topology.crease) & in_front & (t1 > t0)
        return _EdgesOnImage(
            is_contour=is_contour, inside_is_left=on_left[0], can_jump=can_jump,
            a=a, b=b, ha=ha, hb=hb, s0=s0, s1=s1, t0=t0, t1=t1, wa=wa, wb=wb,
        )  # fmt: skip

    def take(self, edge: mi.UInt32) -> _EdgesOnImage:
        """Select some of the edges, (S,)."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return _EdgesOnImage(**{k: dr.gather(type(x), x, edge) for k, x in arrays.items()})

    def length(self, edge: mi.UInt32) -> mi.Float:
        """Return the lengths of the given edges on the image, pixels (S,)."""
        a, b = (dr.gather(mi.Point2f, point, edge) for point in (self.a, self.b))
        share = dr.gather(mi.Float, self.t1, edge) - dr.gather(mi.Float, self.t0, edge)
        return dr.norm(b - a) * share


@dataclass(frozen=True)
class _EdgeSamples:
    """Samples in the middle of equal parts of edges."""

    edge: mi.UInt32  # (S,)
    is_contour: mi.Bool  # (S,) else a crease
    q: mi.Point2f  # (S,) pixels
    h: mi.Float  # (S,) scale
    s: mi.Float  # (S,) share of the edge before it
    w: mi.Float  # (S,) depth
    across: mi.Vector2f  # (S,) m times the distance of a and b, pixels
    step: mi.Vector2f  # (S,) m |edge| / K


def _sample(
    on_image: _EdgesOnImage, edges: mi.UInt32, density: float
) -> tuple[mi.UInt32, _EdgeSamples]:
    """Sample some edges (R,) by eq. 2: the first sample of each (R,), and the samples (S,)."""
    count = mi.UInt32(dr.maximum(dr.ceil(on_image.length(edges) * density), 1))
    start = dr.prefix_sum(count)
    total = dr.sum(count)[0]
    first_of_edge = dr.zeros(mi.UInt32, total)
    dr.scatter(first_of_edge, mi.UInt32(1), start)
    run = dr.prefix_sum(first_of_edge) + first_of_edge - 1
    dr.eval(run, start, count)

    edge, count = dr.gather(mi.UInt32, edges, run), mi.Float(dr.gather(mi.UInt32, count, run))
    part = (dr.arange(mi.UInt32, total) - dr.gather(mi.UInt32, start, run) + 0.5) / count
    e = on_image.take(edge)
    t = dr.lerp(e.t0, e.t1, part)
    s = share_on_segment(t, e.ha, e.hb)
    h = dr.lerp(e.ha, e.hb, s)
    s = dr.lerp(e.s0, e.s1, s)
    across = mi.Vector2f(e.b.y - e.a.y, e.a.x - e.b.x)
    across = dr.select(e.inside_is_left, across, -across)
    step = across * (e.t1 - e.t0) / count
    q, w = dr.lerp(e.a, e.b, t), dr.lerp(e.wa, e.wb, s)
    return start, _EdgeSamples(edge, e.is_contour, q, h, s, w, across, step)


def _is_seen(caster: RayCaster, samples: _EdgeSamples, inner: RayHits, outer: RayHits) -> mi.Bool:
    """Return whether edges are visible at their samples, from the hits of the rays beside them."""
    projection, topology, edge = caster.projection, caster.surface.topology, samples.edge
    at_contour = _is_before(caster, samples, inner)
    at_contour &= ~outer.hit | (outer.depth > samples.w * (1 - OCCLUDER_MARGIN))
    at_crease = inner.hit & outer.hit & _owns(topology, inner.face, edge)
    at_crease &= _owns(topology, outer.face, edge)
    at_edge = dr.select(samples.is_contour, at_contour, at_crease)
    return projection.is_inside(samples.q) & at_edge


def _is_before(caster: RayCaster, samples: _EdgeSamples, inner: RayHits) -> mi.Bool:
    """Return whether the rays on their inner side reach the contours at their samples."""
    surface, projection, edge = caster.surface, caster.projection, samples.edge
    ray = projection.ray(samples.q)
    hidden = _covers(surface, ray, inner.face, samples.w - projection.near)
    before = _owns(surface.topology, inner.face, edge)
    before |= _adjoins(surface.topology, inner.face, edge) & ~hidden
    return inner.hit & before


def _adjoins(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Return whether a face shares a corner with a face of an edge."""
    adjoins = mi.Bool(False)
    for edge_face in topology.edge_faces:
        of_edge = dr.gather(mi.UInt32, edge_face, edge)
        mine = [dr.gather(mi.UInt32, corner, of_edge) for corner in topology.points]
        for corner in topology.points:
            point = dr.gather(mi.UInt32, corner, face)
            adjoins |= (point == mine[0]) | (point == mine[1]) | (point == mine[2])
    return adjoins


def _covers(surface: MeshSurface, ray: mi.Ray3f, face: mi.UInt32, t: mi.Float) -> mi.Bool:
    """Return whether rays meet a face before their parameter ``t``."""
    b1, b2, t_face = meet_plane(ray, *surface.corners_of(face))
    return (b1 > 0) & (b2 > 0) & (b1 + b2 < 1) & (t_face < t)


def _owns(topology: Topology, face: mi.UInt32, edge: mi.UInt32) -> mi.Bool:
    """Return whether an edge is a side of a face."""
    owns = mi.Bool(False)
    for edge_face in topology.edge_faces:
        owns |= face == dr.gather(mi.UInt32, edge_face, edge)
    return owns
