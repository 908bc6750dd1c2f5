"""Interior term of the derivative: the image changes as surfaces move within their contours.

1. A visible point stays on its triangle, and its normal and depth change: ``∂I/∂v = ∫ ∂v/∂x f dA``.
   At grazing angles the integrand grows as one over the cosine of the angle. The rays of the image
   seldom meet such places, and a ray that does counts too much.
2. Therefore two sets of samples are combined: the rays of the image, ``spp`` per pixel of area, and
   one point on every triangle, ``1 / A`` per pixel of area, ``A`` the area in pixels that the
   triangle covers. Triangles at grazing angles cover little.
3. Both have the weight ``1 / (spp + 1 / A)``, one over their common density: the balance heuristic
   of multiple importance sampling (Veach and Guibas, "Optimally Combining Sampling Techniques for
   Monte Carlo Rendering", 1995). No sample weighs more than its triangle covers.
4. With the doubled area ``c`` of a triangle in the world, ``A = |det| |c · d| / 2 h²`` on the ray
   ``o + w d`` at the scale ``h`` (``projection.py``).

Triangles nearly parallel to the ray are left out, because float32 cannot determine where it meets
them.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.pixel_filter import PixelFilter
from gva_mi_plugins.mesh_normals.rays import RayCaster, RayHits
from gva_mi_plugins.mesh_normals.segment_sums import concat
from gva_mi_plugins.mesh_normals.surface import MeshSurface

# Steps of the R2 sequence in two axes: 1/p and 1/p² with p³ = p + 1 (M. Roberts, "The Unreasonable
# Effectiveness of Quasirandom Sequences", 2018).
R2_STEPS = (0.7548776662466927, 0.5698402909980532)
# Sine of the angle between ray and triangle below which the ray is left out. Chosen: float32
# does not determine flatter intersections.
SMALLEST_SINE = 1e-4
# Share of a point's depth by which an occluder must lie nearer than it. Chosen: above float32's
# rounding of a depth.
OCCLUDER_MARGIN = 1e-4


@dataclass(frozen=True)
class Interior:
    """Samples of one view: first the samples on the image's rays, then those on triangles.

    Example:
        A cube covers 4 x 4 pixels. As it comes nearer by 1 m, each of their depths falls by 1 m.

        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> sensor = {"type": "perspective", "fov": 90, "film": film}  # a focal length of 8 px
        >>> cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 5])}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "cube": cube})
        >>> integrator = mi.load_dict({"type": "mesh_normals", "channels": "depth"})
        >>> view = integrator.view(scene, scene.sensors()[0])
        >>> nearer = dr.zeros(mi.Vector3f, view.surface.topology.vertex_count) - [0, 0, 1]
        >>> dr.sum(Interior.of(view.caster, view.filter, view.seen).tangent(nearer)[0])
        [-16]
    """

    caster: RayCaster
    filter: PixelFilter
    rays: mi.UInt32  # (R,) numbers of the image's rays
    q: mi.Point2f  # (S,) pixels, of the samples on triangles
    ray: mi.Ray3f  # (R + S,) through all samples
    face: mi.UInt32  # (R + S,)
    weight: mi.Float  # (R + S,) eq. 3; for the image's rays times spp, by which the filter divides
    crowd: mi.Float  # (S,) 1 / A, of the samples on triangles

    @staticmethod
    def of(caster: RayCaster, filter: PixelFilter, seen: RayHits) -> Interior | None:
        """Gather the samples; None if no mesh is visible. ``seen``: hits of the image's rays."""
        surface, projection = caster.surface, caster.projection
        slanted = _is_slanted(surface, seen.ray, seen.face)
        rays = dr.compress(seen.hit & slanted)
        if dr.width(rays) == 0:
            return None
        face, q = _points_on_triangles(caster)
        at, faces = filter.positions(rays), dr.gather(mi.UInt32, seen.face, rays)
        if dr.width(face) > 0:
            at, faces = concat([at, faces], [q, face])
        dr.eval(at, faces)
        ray = projection.ray(at)
        c = dr.gather(mi.Vector3f, surface.face_normals, faces)
        crowd = 2 * projection.density(c, surface.corners_of(faces)[0], ray)
        weight = filter.balance(crowd, rays)
        crowd = _entries_from(crowd, dr.width(rays))
        return Interior(caster, filter, rays, q, ray, faces, weight, crowd)

    def tangent(self, d_positions: mi.Vector3f) -> list[mi.Float]:
        """Evaluate eq. 1 forward: the change of each channel (H W,) as positions (V,) move."""
        filter, surface, channels = self.filter, self.caster.surface, self.caster.channels
        d_normals = surface.tangent(d_positions)
        dr.eval(d_normals)
        dn, dw = surface.shade_tangent(self.ray, self.face, d_positions, d_normals)
        changes = channels.tangent(dn, dw, self.caster.projection.camera_world)
        changes = [self.weight * x for x in changes]
        dr.eval(changes)
        count = dr.width(self.rays)
        of_image = dr.arange(mi.UInt32, count)
        of_face = dr.arange(mi.UInt32, dr.width(self.face) - count) + dr.opaque(mi.UInt32, count)
        of_image, of_face = (
            [dr.gather(mi.Float, x, index) for x in changes] for index in (of_image, of_face)
        )
        samples = [dr.zeros(mi.Float, filter.width * filter.height * filter.spp) for _ in changes]
        for sample, x in zip(samples, of_image, strict=True):
            dr.scatter(sample, x, self.rays)
        dr.eval(samples)
        image = [mi.Float(x) for x in filter.develop(samples)]
        dr.eval(image)
        if dr.width(self.q) > 0:
            filter.deposit(image, of_face, self.q, self.crowd)
        return image

    def adjoint(self, grads: list[mi.Float]) -> mi.Vector3f:
        """Evaluate eq. 1 backward: from gradients of pixels (H W,) to gradients of positions."""
        by_sample = self.filter.spread(grads, self.rays)
        if dr.width(self.q) > 0:
            on_faces = self.filter.spread_to(grads, self.q, self.crowd)
            by_sample = concat(by_sample, on_faces)
        by_sample = [self.weight * x for x in by_sample]
        surface, camera_world = self.caster.surface, self.caster.projection.camera_world
        grad_n, grad_w = self.caster.channels.adjoint(by_sample, camera_world)
        return surface.adjoint(*surface.shade_adjoint(self.ray, self.face, grad_n, grad_w))


def _entries_from(values: mi.Float, start: int) -> mi.Float:
    """Return the entries of an array from ``start`` on, perhaps none."""
    if dr.width(values) == start:
        return dr.zeros(mi.Float, 0)
    index = dr.arange(mi.UInt32, dr.width(values) - start) + dr.opaque(mi.UInt32, start)
    return dr.gather(mi.Float, values, index)


def _is_slanted(surface: MeshSurface, ray: mi.Ray3f, face: mi.UInt32) -> mi.Bool:
    """Return whether the angle between rays and faces is large enough for float32."""
    c = dr.gather(mi.Vector3f, surface.face_normals, face)
    return dr.abs(dr.dot(c, ray.d)) > SMALLEST_SINE * dr.norm(c) * dr.norm(ray.d)


def _points_on_triangles(caster: RayCaster) -> tuple[mi.UInt32, mi.Point2f]:
    """Place one point on each triangle; return the triangles and pixels (S,) of visible ones."""
    surface, projection = caster.surface, caster.projection
    x = _one_point_each(surface)
    faces_sensor = dr.dot(surface.face_normals, projection.toward(x)) < 0
    q, _ = projection.pixel(x)
    w = projection.depth(x)
    candidate = projection.is_inside(q) & (w > projection.near)
    if surface.is_solid:
        candidate &= faces_sensor  # the others are behind them
    dr.eval(q, w, faces_sensor, candidate)
    face = dr.compress(candidate)
    if dr.width(face) == 0:
        return face, dr.zeros(mi.Point2f, 0)
    q, w = dr.gather(mi.Point2f, q, face), dr.gather(mi.Float, w, face)
    hits = caster.cast(q)
    # The ray to a triangle at a grazing angle may miss it.
    seen = hits.hit & (hits.face == face)
    behind = dr.gather(mi.Bool, faces_sensor, face) & (hits.depth > w * (1 - OCCLUDER_MARGIN))
    seen = dr.compress((seen | behind) & _is_slanted(surface, hits.ray, face))
    if dr.width(seen) == 0:
        return seen, dr.zeros(mi.Point2f, 0)
    return dr.gather(mi.UInt32, face, seen), dr.gather(mi.Point2f, q, seen)


def _one_point_each(surface: MeshSurface) -> mi.Vector3f:
    """Return a point on every triangle (F,), world: a sequence folded into the triangle."""
    face, p = dr.arange(mi.UInt32, surface.topology.face_count), surface.corners
    b1, b2 = (x - dr.floor(x) for x in (0.5 + mi.Float(face) * step for step in R2_STEPS))
    folded = b1 + b2 > 1
    b1, b2 = dr.select(folded, 1 - b1, b1), dr.select(folded, 1 - b2, b2)
    return (1 - b1 - b2) * p[0] + b1 * p[1] + b2 * p[2]
