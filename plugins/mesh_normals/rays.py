"""Rays from the sensor: the faces they meet, the channels there, and jumps between two rays.

Interior, contours and intersections share one :class:`RayCaster`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.channels import Channels
from gva_mi_plugins.mesh_normals.projection import SensorProjection
from gva_mi_plugins.mesh_normals.surface import MeshSurface


@dataclass(frozen=True)
class RayHits:
    """The first hits of some rays."""

    ray: mi.Ray3f  # (R,)
    face: mi.UInt32  # (R,) 0 where nothing is hit
    depth: mi.Float  # (R,)
    hit: mi.Bool  # (R,)


@dataclass(frozen=True)
class RayCaster:
    """Casts rays at the meshes of a scene through the pixels of an image."""

    scene: mi.Scene
    surface: MeshSurface
    projection: SensorProjection
    channels: Channels

    def cast(self, q: mi.Point2f, active: mi.Bool = True) -> RayHits:
        """Shoot rays through pixel positions (R,), if active."""
        ray = self.projection.ray(q)
        # Neighbours of the arrays are neighbours on the image: a tenth less time, the same hits.
        found = self.scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        hit = found.is_valid() & active
        face = self.surface.topology.face_number(found.shape, found.prim_index, hit)
        return RayHits(ray, face, found.t + self.projection.near, hit)

    def meets(self, q: mi.Point2f) -> mi.Bool:
        """Whether rays through pixel positions (R,) meet any face."""
        return self.scene.ray_test(self.projection.ray(q), coherent=True)

    def values(self, hits: RayHits) -> list[mi.Float]:
        """Return each channel where rays hit, (R,); zero elsewhere."""
        if not self.channels.moves_inside:
            return [dr.select(hits.hit, mi.Float(1), 0)]  # the mask
        n, t = self.surface.shade(hits.ray, hits.face, hits.hit)
        w = t + self.projection.near
        return self.channels.values(n, w, hits.hit, self.projection.camera_world)

    def jump(self, inner: RayHits, outer: RayHits, seen: mi.Bool) -> list[mi.Float]:
        """Return ``ΔI = I_inside - I_outside`` of each channel, (R,); zero where not seen."""
        inside, outside = (
            self.values(replace(side, hit=side.hit & seen)) for side in (inner, outer)
        )
        return [dr.select(seen, a - b, 0) for a, b in zip(inside, outside, strict=True)]
