"""``mesh_normals_projective``: the image of ``mesh_normals`` through Mitsuba's projective sampling.

.. pluginparameters::

 * - sppc, sppp
   - |int|
   - Samples of a pixel for the interior and for the boundary of the gradient; 0 leaves that term
     out. (Default: the ``spp`` of the call)

It shows normals in camera space and the mask, (H, W, 4), as ``mesh_normals`` does by default. Its
rays are random, its interior is plain automatic differentiation, and its boundary is Mitsuba's:
random points on silhouettes, projected onto those that are seen. It is slower, noisier and not the
same bits in every run: it is here to check the other one, with which it shares the definition of
the shading normal and nothing that concerns motion.

A projective integrator carries one radiance, of three channels. Two of them stand side by side
here: the radiance of one is the normal, that of the other the mask.

Note:
    Differentiable in ``*.vertex_positions``. Sensors must be ``perspective``, films ``rgb``.
    Creases between visible faces and lines of piercing carry no gradient here, for projective
    sampling knows silhouettes alone; nor does the sensor.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.projection import PINHOLE, Projection
from gva_mi_plugins.mesh_normals.surface import interpolate
from gva_mi_plugins.mesh_normals.topology import Topology, meshes_of
from mitsuba.python.ad.integrators.common import PSIntegrator

NORMAL, MASK = "normal", "mask"


class SurfaceRadiance(PSIntegrator):
    """Surfaces whose radiance is their normal, in camera space, or one: the mask."""

    def __init__(self, what: str, sppc: int | None, sppp: int | None) -> None:
        super().__init__(mi.Properties())
        self.what = what
        self.sppc, self.sppp, self.sppi = sppc, sppp, 0  # nothing is seen indirectly
        self.radiative_backprop = False
        self.sample_border_warning = False  # a box filter looks at no border
        self._meshes: list[mi.Mesh] = []
        self._topology: Topology | None = None
        self._camera_world: mi.Matrix3f | None = None

    def set_scene(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        """Take the meshes of a scene and the axes of a sensor."""
        with dr.suspend_grad():
            self._meshes = meshes_of(scene)
            self._topology = Topology.of(self._meshes)
            self._camera_world = Projection.of(sensor).camera_world

    def sample(
        self,
        mode: dr.ADMode,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        active: mi.Bool = True,
        **kwargs: object,
    ) -> tuple[mi.Color3f, mi.Bool, list[mi.Float], None]:
        """The radiance along rays; see Mitsuba's ``PSIntegrator.sample``."""
        found = scene.ray_intersect_preliminary(ray, coherent=False, active=active)
        hit = found.is_valid()
        with dr.resume_grad(when=mode != dr.ADMode.Primal):
            corners = self._corners(found.shape, found.prim_index, hit)
            n, _ = interpolate(ray, *corners)
            # Made here: outside, the spectrum would be detached without a word.
            radiance = dr.select(hit, self._radiance(n), 0)
        return radiance, hit, [], None

    def sample_radiance_difference(
        self,
        scene: mi.Scene,
        ss: mi.SilhouetteSample3f,
        curr_depth: int,
        sampler: mi.Sampler,
        wavelengths: mi.Color0f,
        active: mi.Bool,
    ) -> tuple[mi.Color3f, mi.Bool]:
        """The jump across a silhouette, surface less background."""
        behind, *_ = self.sample(dr.ADMode.Primal, scene, sampler, ss.spawn_ray(), active)
        *_, n0, n1, n2 = self._corners(ss.shape, ss.prim_index, active)
        b1, b2 = ss.uv
        n = (1 - b1 - b2) * n0 + b1 * n1 + b2 * n2
        n /= dr.norm(n)
        jump = dr.select(active, self._radiance(n) - behind, 0)
        return jump, active & dr.any(jump != 0)

    def _radiance(self, n: mi.Vector3f) -> mi.Color3f:
        if self.what == MASK:
            return mi.Color3f(1)
        n = self._camera_world @ n
        return mi.Color3f(n.x, n.y, n.z)

    def _corners(
        self, shape: mi.ShapePtr, prim: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.Vector3f, ...]:
        """Corners p_0, p_1, p_2 of faces and their shading normals n_0, n_1, n_2."""
        t = self._topology
        face = dr.gather(mi.UInt32, t.first_face, dr.reinterpret_array(mi.UInt32, shape), active)
        face = dr.select(active, face + prim, 0)
        buffers = [mesh.vertex_positions_buffer() for mesh in self._meshes]
        positions = buffers[0] if len(buffers) == 1 else dr.concat(buffers)
        positions = dr.unravel(mi.Vector3f, positions)
        p = [dr.gather(mi.Vector3f, positions, vertex) for vertex in t.vertices]
        c = dr.cross(p[1] - p[0], p[2] - p[0])
        normals = dr.zeros(mi.Vector3f, t.normal_count)
        for index in t.normals:
            dr.scatter_add(normals, c, index)
        normals /= dr.norm(normals)
        at = lambda source, columns: [
            dr.gather(mi.Vector3f, source, dr.gather(mi.UInt32, column, face, active), active)
            for column in columns
        ]
        return (*at(positions, t.vertices), *at(normals, t.normals))


class MeshNormalsProjective(mi.ad.integrators.common.ADIntegrator):
    """The integrator; see the module's docstring."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        samples = props.get("sppc", None), props.get("sppp", None)
        self.integrators = [SurfaceRadiance(what, *samples) for what in (NORMAL, MASK)]

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
        sensor = self._prepare(scene, sensor)
        return _joined(
            [integrator.render(scene, sensor, seed, spp) for integrator in self.integrators]
        )

    def render_forward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> mi.TensorXf:
        """Derivative of the image (H, W, 4) in the direction of the positions' gradients."""
        sensor = self._prepare(scene, sensor)
        buffers = [mesh.vertex_positions_buffer() for mesh in meshes_of(scene)]
        buffers = [buffer for buffer in buffers if dr.grad_enabled(buffer)]
        dr.forward_to(buffers)
        grads, images = [dr.grad(buffer) for buffer in buffers], []
        for (
            integrator
        ) in self.integrators:  # each traversal takes the gradients that it starts from
            for buffer, grad in zip(buffers, grads, strict=True):
                dr.set_grad(buffer, grad)
            images.append(integrator.render_forward(scene, params, sensor, seed, spp))
        return _joined(images)

    def render_backward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        grad_in: mi.TensorXf,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> None:
        """Add the gradient by the image (H, W, 4) to the gradients of the positions."""
        sensor = self._prepare(scene, sensor)
        height, width, _ = grad_in.shape
        pixel = dr.arange(mi.UInt32, height * width)
        channels = [dr.gather(mi.Float, grad_in.array, 4 * pixel + c) for c in range(4)]
        zero = dr.zeros(mi.Float, height * width)
        for integrator, rgb in zip(
            self.integrators, (channels[:3], [channels[3], zero, zero]), strict=True
        ):
            grad = mi.TensorXf(dr.ravel(mi.Color3f(rgb)), (height, width, 3))
            integrator.render_backward(scene, params, grad, sensor, seed, spp)

    def aov_names(self) -> list[str]:
        """Names of the channels."""
        return ["normal.X", "normal.Y", "normal.Z", "mask"]

    def to_string(self) -> str:
        """As Mitsuba prints it."""
        first = self.integrators[0]
        return f"MeshNormalsProjective[sppc={first.sppc}, sppp={first.sppp}]"

    def _prepare(self, scene: mi.Scene, sensor: mi.Sensor | int) -> mi.Sensor:
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film = sensor.film()
        if sensor.class_name() != PINHOLE:
            raise ValueError(
                f"mesh_normals_projective: sensor must be 'perspective', got {sensor.class_name()}"
            )
        if film.base_channels_count() != 3 or not film.rfilter().is_box_filter():
            raise ValueError(
                "mesh_normals_projective: the film's pixel_format must be 'rgb', its filter 'box'"
            )
        for integrator in self.integrators:
            integrator.set_scene(scene, sensor)
        return sensor


def _joined(images: list[mi.TensorXf]) -> mi.TensorXf:
    """The normals (H, W, 3) and the first channel of the mask (H, W, 3) as one image."""
    normal, mask = images
    height, width, _ = normal.shape
    pixel = dr.arange(mi.UInt32, height * width)
    image = dr.empty(mi.Float, 4 * height * width)
    for c in range(4):
        source, channel = (normal, c) if c < 3 else (mask, 0)
        dr.scatter(image, dr.gather(mi.Float, source.array, 3 * pixel + channel), 4 * pixel + c)
    return mi.TensorXf(image, (height, width, 4))
