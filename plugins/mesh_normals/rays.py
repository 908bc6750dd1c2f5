"""Rays from the sensor: the faces that they meet, the image's channels, jumps between two rays.

Interior, contours and intersections share one :class:`RayCaster`.

==================  ========  ==================================================================
Name                Channels  A pixel holds
==================  ========  ==================================================================
``normal``          3         the shading normal, in camera or world space
``mask``            1         1 where a mesh is visible
``depth``           1         the distance from the sensor's plane, scene units
==================  ========  ==================================================================

All are zero where no mesh is visible. A pixel is the mean over its area, so ``depth`` divided by
``mask`` is the mean depth of the meshes in it.

Camera space has OpenCV's axes, x right, y down, z forward: a surface that faces the camera has
``n_z < 0``. Normals are not turned toward the camera: on the inner side of an open mesh they point
away from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.projection import SensorProjection
from gva_mi_plugins.mesh_normals.surface import MeshSurface

WIDTHS = {"normal": 3, "mask": 1, "depth": 1}
SPACES = ("camera", "world")


@dataclass(frozen=True)
class Channels:
    """Channels of an image, in order."""

    kinds: tuple[str, ...]  # names in WIDTHS
    space: str  # of the normals

    @staticmethod
    def parse(channels: str, space: str) -> Channels:
        """Parse a plugin's parameters, such as ``"normal, mask"`` and ``"camera"``.

        Raises:
            ValueError: a name does not exist or comes twice.

        Example:
            >>> channels = Channels.parse("mask, normal", "camera")
            >>> channels.names, channels.first("normal")
            (['mask', 'normal.X', 'normal.Y', 'normal.Z'], 1)
        """
        kinds = tuple(name.strip() for name in channels.split(","))
        unknown = [kind for kind in kinds if kind not in WIDTHS]
        if unknown or len(set(kinds)) < len(kinds):
            raise ValueError(
                f"mesh_normals: channels must be some of {', '.join(WIDTHS)}, each once, "
                f"got '{channels}'"
            )
        if space not in SPACES:
            raise ValueError(f"mesh_normals: space must be 'camera' or 'world', got '{space}'")
        return Channels(kinds, space)

    @property
    def names(self) -> list[str]:
        """Return one name for each channel."""
        axes = {"normal": ["normal.X", "normal.Y", "normal.Z"]}
        return [name for kind in self.kinds for name in axes.get(kind, [kind])]

    @property
    def moves_inside(self) -> bool:
        """Return whether any channel changes as a surface moves within its contours."""
        return "normal" in self.kinds or "depth" in self.kinds

    def first(self, kind: str) -> int | None:
        """Return the number of a kind's first channel; None if the image lacks it."""
        if kind not in self.kinds:
            return None
        return sum(WIDTHS[k] for k in self.kinds[: self.kinds.index(kind)])

    def values(
        self, n: mi.Vector3f, w: mi.Float, hit: mi.Bool, camera_world: mi.Matrix3f
    ) -> list[mi.Float]:
        """Return the channels' values on rays (R,).

        Unit normals n (world) are zero where nothing is hit; w are depths. ``camera_world`` rotates
        from the world to the camera.
        """
        n = self._to_space(n, camera_world)
        of_kind = {
            "normal": list(n),
            "mask": [dr.select(hit, mi.Float(1), 0)],
            "depth": [dr.select(hit, w, 0)],
        }
        return [value for kind in self.kinds for value in of_kind[kind]]

    def tangent(self, dn: mi.Vector3f, dw: mi.Float, camera_world: mi.Matrix3f) -> list[mi.Float]:
        """Return the tangents of the channels on rays whose hits stay on their faces."""
        dn = self._to_space(dn, camera_world)
        of_kind = {"normal": list(dn), "depth": [dw]}
        zeros = lambda kind: [mi.Float(0)] * WIDTHS[kind]
        return [value for kind in self.kinds for value in of_kind.get(kind, zeros(kind))]

    def adjoint(
        self, grads: list[mi.Float], camera_world: mi.Matrix3f
    ) -> tuple[mi.Vector3f | None, mi.Float | None]:
        """Return the gradients of normals (world) and of depths, given those of the channels.

        None for a kind that the image lacks.
        """
        normal, depth = self.first("normal"), self.first("depth")
        grad_n = None
        if normal is not None:
            grad_n = mi.Vector3f(grads[normal : normal + 3])
            if self.space == "camera":
                grad_n = camera_world.T @ grad_n
        return grad_n, None if depth is None else grads[depth]

    def _to_space(self, n: mi.Vector3f, camera_world: mi.Matrix3f) -> mi.Vector3f:
        """Convert normals from world space to the image's space."""
        return n if self.space == "world" else camera_world @ n


@dataclass(frozen=True)
class RayHits:
    """The first hits of rays.

    Example:
        A ray that misses does not count, whatever it is given as a depth.

        >>> hits = RayHits(mi.Ray3f(), mi.UInt32(7, 0), mi.Float(4, dr.inf), mi.Bool(True, False))
        >>> dr.select(hits.hit, hits.depth, 0)
        [4, 0]
    """

    ray: mi.Ray3f  # (R,)
    face: mi.UInt32  # (R,) 0 where nothing is hit
    depth: mi.Float  # (R,)
    hit: mi.Bool  # (R,)


@dataclass(frozen=True)
class RayCaster:
    """Casts rays at the meshes of a scene through the pixels of an image.

    Example:
        A cube, whose front is 4 m away, in the middle of the image, and nothing in its corner.

        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> sensor = {"type": "perspective", "fov": 90, "film": film}  # a focal length of 8 px
        >>> cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 5])}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "cube": cube})
        >>> integrator = mi.load_dict({"type": "mesh_normals", "channels": "normal"})
        >>> caster = integrator.view(scene, scene.sensors()[0]).caster
        >>> hits = caster.cast(mi.Point2f([8, 1], [8, 1]))
        >>> hits.hit, hits.depth, caster.values(hits)[2]  # n_z of a surface facing the camera
        ([True, False], [4, inf], [-1, 0])
    """

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
        """Return whether rays through pixel positions (R,) meet any face."""
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
