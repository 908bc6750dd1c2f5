"""A sensor's image of the meshes of a scene, with its tangent and its adjoint.

1. A pixel is the mean over its area, ``I = ∫ f v dA``, of the visible values ``v``: the channels
   of ``rays.py``. It is estimated by ``spp`` rays at fixed places, one in the middle or a lattice.
   There is no noise: two renderings are equal to the last bit.
2. **Interior**: under a small motion a ray keeps its triangle, while normals, depths and
   barycentric coordinates change with the vertices (``interior.py``).
3. **Boundary**: edges sweep over the image and move its jumps (``contours.py``), and so do the
   lines in which surfaces intersect (``intersections.py``). The mask has no other derivative, and
   without this term the derivative of the normals is wrong even in sign.
4. **Sensor**: a motion of the sensor is the opposite motion of all vertices; normals in world axes
   also turn with the sensor (``projection.py``, eq. 6).

Terms 2 and 3 are the two terms of Reynolds' transport theorem, sampled as in Li et al.,
"Differentiable Monte Carlo Ray Tracing through Edge Sampling", 2018. They approximate the
derivative of the exact mean over a pixel's area, also at one ray per pixel. Nothing here uses
automatic differentiation across the view, so code with its own loop can use :class:`MeshView`, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.contours import Contours
from gva_mi_plugins.mesh_normals.interior import Interior
from gva_mi_plugins.mesh_normals.intersections import Intersections
from gva_mi_plugins.mesh_normals.pixel_filter import PixelFilter
from gva_mi_plugins.mesh_normals.rays import RayCaster, RayHits
from gva_mi_plugins.mesh_normals.surface import MeshSurface


@dataclass(frozen=True)
class MeshView:
    """An image of a scene's meshes, with the state that its derivatives need.

    A view becomes invalid when vertices move: then make another one.

    Example:
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 6])}
        >>> sensor = {"type": "perspective", "film": film}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "cube": cube})
        >>> view = mi.load_dict({"type": "mesh_normals"}).view(scene, scene.sensors()[0])
        >>> view.image().shape  # normal and mask
        (16, 16, 4)
        >>> right = mi.Vector3f(1, 0, 0) + dr.zeros(mi.Vector3f, view.surface.topology.vertex_count)
        >>> interior, boundary = view.tangent_parts(right)
        >>> dr.all(interior[:, :, 3] == 0, axis=None)  # the mask changes only at contours
        True
        >>> dr.any(boundary[:, :, 3] != 0, axis=None)
        True
    """

    caster: RayCaster
    filter: PixelFilter
    edge_density: float  # samples per pixel of an edge's length, at one ray per pixel
    with_intersections: bool  # whether lines in which surfaces intersect have a gradient
    seen: RayHits  # the hit of each ray, (H W spp,)

    @staticmethod
    def of(
        caster: RayCaster, filter: PixelFilter, edge_density: float, with_intersections: bool
    ) -> MeshView:
        """Shoot the rays of the image (eq. 1)."""
        seen = caster.cast(filter.positions())
        dr.eval(seen.face, seen.hit)
        return MeshView(caster, filter, edge_density, with_intersections, seen)

    @property
    def surface(self) -> MeshSurface:
        """The visible meshes."""
        return self.caster.surface

    def image(self) -> mi.TensorXf:
        """Return the image of the view's channels, (H, W, C)."""
        return self._tensor(self.filter.develop(self.caster.values(self.seen)))

    def tangent(
        self, d_positions: mi.Vector3f, d_to_world: mi.Matrix4f | None = None
    ) -> mi.TensorXf:
        """Return the derivative of the image (H, W, C) as vertices (V,) and the sensor's pose
        move."""
        carried = self.caster.projection.carried
        if d_to_world is not None:
            d_positions = d_positions - carried(d_to_world, self.surface.positions, 1)
        interior, boundary = self._tangents(d_positions)
        image = [x + y for x, y in zip(interior, boundary, strict=True)]
        if d_to_world is not None and self._has_world_normals():
            turned = carried(d_to_world, self._normals(), 0)
            for k, value in enumerate(turned, self.caster.channels.first("normal")):
                image[k] = image[k] + value
        return self._tensor(image)

    def tangents(self, motions: Iterable[mi.Vector3f]) -> Iterator[mi.TensorXf]:
        """Yield :meth:`tangent` for one motion of the positions (V,) after the other.

        The places of the samples do not depend on the motion, so each takes a tenth of the time.
        """
        terms = self._interior_term(), self._boundary_terms()
        for d_positions in motions:
            inside, jumps = self._tangents(d_positions, terms)
            yield self._tensor([x + y for x, y in zip(inside, jumps, strict=True)])

    def tangent_parts(self, d_positions: mi.Vector3f) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return the two terms of :meth:`tangent`: interior and boundary, each (H, W, C)."""
        interior, boundary = self._tangents(d_positions)
        return self._tensor(interior), self._tensor(boundary)

    def adjoint(self, grad_image: mi.TensorXf) -> mi.Vector3f:
        """Convert the image's gradient (H, W, C) to the gradient of the positions (V,)."""
        interior, boundary = self.adjoint_parts(grad_image)
        return interior + boundary

    def adjoint_parts(self, grad_image: mi.TensorXf) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return the two terms of :meth:`adjoint`: interior and boundary, each (V,)."""
        grads = self._channels_of(grad_image)
        nothing = dr.zeros(mi.Vector3f, self.surface.topology.vertex_count)
        interior = self._interior_term()
        inside = nothing if interior is None else interior.adjoint(grads)
        jumps = nothing
        for boundary in self._boundary_terms():
            jumps = jumps + boundary.adjoint(self.filter.spread_to(grads, boundary.q))
        return inside, jumps

    def adjoint_to_world(self, grad_image: mi.TensorXf, grad_positions: mi.Vector3f) -> mi.Matrix4f:
        """Convert the image's gradient (H, W, C) to the gradient of the sensor's ``to_world``.

        ``grad_positions`` (V,) is the result of :meth:`adjoint` for this image.
        """
        carried_adjoint = self.caster.projection.carried_adjoint
        grad = carried_adjoint(-grad_positions, self.surface.positions, 1)
        if self._has_world_normals():
            normal = self.caster.channels.first("normal")
            grad_n = mi.Vector3f(self._channels_of(grad_image)[normal : normal + 3])
            grad = grad + carried_adjoint(grad_n, self._normals(), 0)
        return grad

    def _tangents(
        self,
        d_positions: mi.Vector3f,
        terms: tuple[Interior | None, list[Contours | Intersections]] | None = None,
    ) -> tuple[list[mi.Float], list[mi.Float]]:
        """Return interior and boundary derivative, for each channel (H W,)."""
        interior, boundaries = terms or (self._interior_term(), self._boundary_terms())
        size, names = self.filter.width * self.filter.height, self.caster.channels.names
        nothing = [dr.zeros(mi.Float, size) for _ in names]
        inside = nothing if interior is None else interior.tangent(d_positions)
        jumps = [mi.Float(x) for x in nothing]
        for boundary in boundaries:
            self.filter.deposit(jumps, boundary.tangent(d_positions), boundary.q)
        return inside, jumps

    def _interior_term(self) -> Interior | None:
        if not self.caster.channels.moves_inside:
            return None
        return Interior.of(self.caster, self.filter, self.seen)

    def _boundary_terms(self) -> list[Contours | Intersections]:
        density = self.edge_density * self.filter.spp**0.5
        terms = [Contours.of(self.caster, density)]
        # Where surfaces intersect, only the normal jumps.
        if self.with_intersections and "normal" in self.caster.channels.kinds:
            terms.append(Intersections.of(self.caster, density))
        return [term for term in terms if term is not None]

    def _has_world_normals(self) -> bool:
        channels = self.caster.channels
        return channels.space == "world" and "normal" in channels.kinds

    def _normals(self) -> mi.Vector3f:
        """The normals of the image, (H W,)."""
        normal = self.caster.channels.first("normal")
        return mi.Vector3f(self._channels_of(self.image())[normal : normal + 3])

    def _channels_of(self, image: mi.TensorXf) -> list[mi.Float]:
        """Split an image (H, W, C) into C arrays (H W,)."""
        count = len(self.caster.channels.names)
        if count == 1:
            return [mi.Float(image.array)]
        if count == 4:
            return list(dr.unravel(mi.Vector4f, mi.Float(image.array)))
        index = count * dr.arange(mi.UInt32, self.filter.width * self.filter.height)
        channels = [dr.gather(mi.Float, image.array, index + c) for c in range(count)]
        dr.eval(channels)
        return channels

    def _tensor(self, channels: list[mi.Float]) -> mi.TensorXf:
        """Join C arrays (H W,) to an image (H, W, C); the reverse of :meth:`_channels_of`."""
        count, size = len(channels), self.filter.width * self.filter.height
        if count == 1:
            image = mi.Float(channels[0])
        elif count == 4:
            image = dr.ravel(mi.Vector4f(channels))
        else:
            index = count * dr.arange(mi.UInt32, size)
            image = dr.empty(mi.Float, size * count)
            for c, channel in enumerate(channels):
                dr.scatter(image, channel, index + c)
        return mi.TensorXf(image, (self.filter.height, self.filter.width, count))
