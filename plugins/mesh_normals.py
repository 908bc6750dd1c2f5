"""``mesh_normals``: an integrator that shows normals and mask of meshes, with right gradients.

The image has four channels: the shading normal in camera space (OpenCV axes: x right, y down, z
forward, so that a surface turned to the camera has ``n_z < 0``), and the mask. Where no mesh is
seen all four are zero.

1. A pixel is the mean over its area, ``I = ∫ (n, 1) dA``, by ``spp`` rays at fixed places: one in
   the middle, or a lattice. There is no noise: ``seed`` has no effect, and two renderings are equal
   to the last bit.
2. **Interior**: triangles that rays meet stay the same under a small motion; normals and
   barycentric coordinates move with the vertices (:mod:`gva_mi_plugins.surface`).
3. **Boundary**: edges sweep over the image and carry its jumps along
   (:mod:`gva_mi_plugins.boundary`). The mask has no other derivative, and without it the normals'
   is wrong even in sign.

The derivative is that of the exact mean over a pixel's area, also at one sample for each pixel.

Parameters:
    ``edge_density`` (float): boundary samples for a pixel of an edge's length, at one sample for
        each pixel; they grow with the root of ``spp``. Default: 1.
    ``pixel_aspect`` (float): width of a pixel over its height, ``f_y / f_x``, which Mitsuba's
        sensors cannot express. Default: 1.

A mesh with ``face_normals`` is faceted; any other is smooth, with normals averaged from its faces
by area (those in a file are not looked at: they would not move with the vertices).

Note:
    Differentiable in the vertices' positions. Not in the sensor; and where two surfaces pierce one
    another, the line in which they meet is no edge and carries no gradient. An edge that reaches
    before the near plane of the sensor is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.boundary import Boundary
from gva_mi_plugins.projection import Projection
from gva_mi_plugins.surface import Surface
from gva_mi_plugins.topology import Topology, build

GOLDEN = 0.6180339887498949  # 1 / golden ratio: the step of a lattice without gaps


@dataclass(frozen=True)
class View:
    """What a camera sees of the meshes of a scene, kept to be differentiated.

    It holds for the scene as it was: after the vertices moved, make another one.
    """

    scene: mi.Scene
    projection: Projection
    surface: Surface
    spp: int
    edge_density: float
    near: float
    face: mi.UInt32  # (H W spp,) the face that each ray met
    hit: mi.Bool  # (H W spp,)

    @staticmethod
    def of(
        scene: mi.Scene,
        projection: Projection,
        surface: Surface,
        spp: int,
        edge_density: float,
        near: float,
    ) -> View:
        """Eq. 1: shoot the rays."""
        ray = projection.ray(_positions(projection, spp))
        face, _, hit = _cast(scene, surface.topology, ray, coherent=True)
        dr.eval(face, hit)
        return View(scene, projection, surface, spp, edge_density, near, face, hit)

    def image(self) -> mi.TensorXf:
        """Normals and mask, (H, W, 4)."""
        ray = self.projection.ray(_positions(self.projection, self.spp))
        n = self.projection.camera_world @ self.surface.shade(ray, self.face, self.hit)
        return self._tensor(mi.Vector4f(n.x, n.y, n.z, dr.select(self.hit, 1, 0)))

    def tangent(self, d_positions: mi.Vector3f) -> mi.TensorXf:
        """How the image (H, W, 4) changes as the vertices move by ``d_positions`` (V,)."""
        d_image = dr.zeros(mi.Vector4f, dr.width(self.face))
        rays = dr.compress(self.hit)
        if dr.width(rays) > 0:
            ray, face = self._seen(rays)
            d_normals = self.surface.tangent(d_positions)
            dr.eval(d_normals)
            dn = self.projection.camera_world @ self.surface.shade_tangent(
                ray, face, d_positions, d_normals
            )
            dr.scatter(d_image, mi.Vector4f(dn.x, dn.y, dn.z, 0), rays)
            dr.eval(d_image)
        image = self._pixels(d_image)
        boundary = self._boundary()
        if boundary is not None:
            sums, pixels = boundary.tangent(d_positions)
            dr.scatter_add(image, sums, pixels, mode=dr.ReduceMode.NoConflicts)
            dr.eval(image)
        return self._tensor(image, per_pixel=True)

    def adjoint(self, grad_image: mi.TensorXf) -> mi.Vector3f:
        """From the gradient by the image (H, W, 4) to that by the vertices' positions (V,)."""
        interior, boundary = self.adjoint_parts(grad_image)
        return interior + boundary

    def adjoint_parts(self, grad_image: mi.TensorXf) -> tuple[mi.Vector3f, mi.Vector3f]:
        """The two terms of :meth:`adjoint` apart: interior and boundary, each (V,)."""
        grad = dr.unravel(mi.Vector4f, mi.Float(grad_image.array))
        zero = dr.zeros(mi.Vector3f, self.surface.topology.vertex_count)
        interior, boundary = zero, self._boundary()
        rays = dr.compress(self.hit)
        if dr.width(rays) > 0:
            ray, face = self._seen(rays)
            g = dr.gather(mi.Vector4f, grad, rays // self.spp) / self.spp
            grad_n = self.projection.camera_world.T @ mi.Vector3f(g.x, g.y, g.z)
            interior = self.surface.adjoint(*self.surface.shade_adjoint(ray, face, grad_n))
        return interior, zero if boundary is None else boundary.adjoint(grad)

    def _seen(self, rays: mi.UInt32) -> tuple[mi.Ray3f, mi.UInt32]:
        """Some of the view's rays, and the faces they hit."""
        q = _positions(self.projection, self.spp, rays)
        return self.projection.ray(q), dr.gather(mi.UInt32, self.face, rays)

    def _boundary(self) -> Boundary | None:
        topology = self.surface.topology
        cast = lambda ray: _cast(self.scene, topology, ray, coherent=False)
        density = self.edge_density * self.spp**0.5
        return Boundary.of(self.surface, self.projection, cast, density, self.near)

    def _pixels(self, samples: mi.Vector4f) -> mi.Vector4f:
        """Means over the samples of each pixel, which lie side by side."""
        if self.spp == 1:
            return samples
        return mi.Vector4f([dr.block_sum(x, self.spp) / self.spp for x in samples])

    def _tensor(self, samples: mi.Vector4f, per_pixel: bool = False) -> mi.TensorXf:
        pixels = samples if per_pixel else self._pixels(samples)
        shape = (self.projection.height, self.projection.width, 4)
        return mi.TensorXf(dr.ravel(pixels), shape)


class MeshNormals(mi.ad.integrators.common.ADIntegrator):
    """The integrator; see the module's docstring."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.edge_density = float(props.get("edge_density", 1.0))
        self.pixel_aspect = float(props.get("pixel_aspect", 1.0))
        for name in ("edge_density", "pixel_aspect"):
            if not getattr(self, name) > 0:
                raise ValueError(f"mesh_normals: {name} must be positive")
        self._topology: tuple[list[mi.UInt32], Topology] | None = None

    def view(self, scene: mi.Scene, sensor: mi.Sensor, spp: int = 1) -> View:
        """What a sensor sees: the image and its derivatives, without automatic differentiation.

        Raises:
            ValueError: a shape that is no mesh, or a sensor or a filter that cannot be used.
        """
        if not sensor.film().rfilter().is_box_filter():
            raise ValueError("mesh_normals: the film's reconstruction filter must be 'box'")
        if spp < 1:
            raise ValueError(f"mesh_normals: spp must be at least 1, got {spp}")
        with dr.suspend_grad():
            meshes = _meshes(scene)
            buffers = [dr.detach(mesh.vertex_positions_buffer()) for mesh in meshes]
            positions = _joined([dr.unravel(mi.Vector3f, x) for x in buffers])
            surface = Surface.of(self._topology_of(meshes), positions)
            projection = Projection.of(sensor, self.pixel_aspect)
            return View.of(
                scene, projection, surface, spp, self.edge_density, float(sensor.near_clip())
            )

    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """The image, (H, W, 4)."""
        sensor, spp = _arguments(scene, sensor, spp)
        with dr.suspend_grad():
            image = self.view(scene, sensor, spp).image()
            if evaluate:
                dr.eval(image)
            return image

    def render_forward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> mi.TensorXf:
        """Derivative of the image (H, W, 4) in the direction that the positions' gradients hold."""
        sensor, spp = _arguments(scene, sensor, spp)
        buffers = [mesh.vertex_positions_buffer() for mesh in _meshes(scene)]
        dr.forward_to([buffer for buffer in buffers if dr.grad_enabled(buffer)])
        moves = [dr.unravel(mi.Vector3f, dr.grad(buffer)) for buffer in buffers]
        with dr.suspend_grad():
            return self.view(scene, sensor, spp).tangent(_joined(moves))

    def render_backward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        grad_in: mi.TensorXf,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> None:
        """Add the gradient by the image (H, W, 4) to the gradients of the vertices' positions."""
        sensor, spp = _arguments(scene, sensor, spp)
        with dr.suspend_grad():
            view = self.view(scene, sensor, spp)
            grad = view.adjoint(grad_in)
            dr.eval(grad)
        start = 0
        for mesh in _meshes(scene):
            count, buffer = mesh.vertex_count(), mesh.vertex_positions_buffer()
            index = dr.arange(mi.UInt32, count) + start
            start += count
            with dr.resume_grad():
                if dr.grad_enabled(buffer):
                    dr.backward(buffer * dr.ravel(dr.gather(mi.Vector3f, grad, index)))

    def aov_names(self) -> list[str]:
        """Names of the channels."""
        return ["normal.X", "normal.Y", "normal.Z", "mask"]

    def to_string(self) -> str:
        """As Mitsuba prints it."""
        return f"MeshNormals[edge_density={self.edge_density}, pixel_aspect={self.pixel_aspect}]"

    def _topology_of(self, meshes: list[mi.Mesh]) -> Topology:
        """Built anew only where the faces are other ones."""
        faces = [mesh.faces_buffer() for mesh in meshes]
        if self._topology is None or [x.index for x in faces] != [
            x.index for x in self._topology[0]
        ]:
            self._topology = (faces, build(meshes))
        return self._topology[1]


def _arguments(scene: mi.Scene, sensor: mi.Sensor | int, spp: int) -> tuple[mi.Sensor, int]:
    sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
    return sensor, spp or sensor.sampler().sample_count()


def _meshes(scene: mi.Scene) -> list[mi.Mesh]:
    meshes = scene.shapes()
    for shape in meshes:
        if not shape.is_mesh():
            raise ValueError(
                "mesh_normals: every shape must be a triangle mesh, "
                f"'{shape.id()}' is {shape.class_name()}"
            )
    if not meshes:
        raise ValueError("mesh_normals: the scene has no shape")
    return meshes


def _joined(values: list[mi.Vector3f]) -> mi.Vector3f:
    if len(values) == 1:
        return values[0]
    return mi.Vector3f([dr.concat([value[k] for value in values]) for k in range(3)])


def _positions(projection: Projection, spp: int, rays: mi.UInt32 | None = None) -> mi.Point2f:
    """Pixel positions of rays: pixel by pixel, and in each a lattice of ``spp`` points."""
    width, height = projection.width, projection.height
    if rays is None:
        rays = dr.arange(mi.UInt32, width * height * spp)
    pixel = rays // spp
    k = mi.Float(rays - pixel * spp)
    y = pixel // width
    x = pixel - y * width
    shift_y = 0.5 + k * GOLDEN
    return mi.Point2f(x + (k + 0.5) / spp, y + shift_y - dr.floor(shift_y))


def _cast(
    scene: mi.Scene, topology: Topology, ray: mi.Ray3f, coherent: bool
) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
    """The face that a ray meets first, its depth, and whether there is one."""
    found = scene.ray_intersect_preliminary(ray, coherent=coherent)
    hit = found.is_valid()
    shape = dr.reinterpret_array(mi.UInt32, found.shape)
    face = dr.gather(mi.UInt32, topology.first_face, shape, hit) + found.prim_index
    return dr.select(hit, face, 0), found.t, hit
