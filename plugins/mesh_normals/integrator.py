"""``mesh_normals``: an integrator that renders normals and mask of meshes, with correct gradients.

.. pluginparameters::

 * - channels
   - |string|
   - What the image holds, in this order: some of ``normal`` (3 channels), ``mask`` and
     ``depth``, as ``rays.py`` defines them. (Default: ``normal, mask``)
 * - space
   - |string|
   - Axes of the normals: ``camera`` (x right, y down, z forward) or ``world``. (Default:
     ``camera``)
 * - edge_density
   - |float|
   - Boundary samples per pixel of an edge's length, at one ray per pixel; they grow with the root
     of ``spp``. (Default: 4)
 * - intersections
   - |bool|
   - Whether lines in which surfaces intersect have a gradient, too. (Default: true)
 * - flat_faces
   - |bool|
   - Whether every image looks for degenerate faces. (Default: true)
 * - pixel_aspect
   - |float|
   - Width of a pixel over its height, ``f_y / f_x``, which Mitsuba's sensors cannot express.
     (Default: 1)

Every shape must be a mesh. ``ellipsoids`` and ``ellipsoidsmesh`` are ignored, so one scene serves
this plugin and ``gaussian_splat``. ``topology.py`` says which normals and edges a
mesh has. Sensors are ``perspective`` or ``orthographic``; films may have any filter and any
crop window.

Differentiable parameters, under the names that ``mi.traverse`` gives them: ``*.vertex_positions``
of every mesh, and ``to_world`` of the sensor. ``mesh_view.py`` explains the method, which follows
Li et al., "Differentiable Monte Carlo Ray Tracing through Edge Sampling", 2018.

Note:
    There is no noise and ``seed`` has no effect. Not differentiable: the field of view and the
    principal point, and the lines in which the near and far planes cut a mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.mesh_view import MeshView
from gva_mi_plugins.mesh_normals.pixel_filter import MultiCrop, PixelFilter, Tile
from gva_mi_plugins.mesh_normals.projection import SensorProjection
from gva_mi_plugins.mesh_normals.rays import Channels, RayCaster
from gva_mi_plugins.mesh_normals.surface import MeshSurface
from gva_mi_plugins.mesh_normals.topology import Topology, Welds


class MeshNormals(mi.ad.integrators.common.ADIntegrator):
    """The integrator ``mesh_normals``; the module's docstring describes it.

    Example:
        >>> film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 6])}
        >>> sensor = {"type": "perspective", "film": film}
        >>> scene = mi.load_dict({"type": "scene", "sensor": sensor, "cube": cube})
        >>> parameters = mi.traverse(scene)
        >>> dr.enable_grad(parameters["cube.vertex_positions"])
        >>> _ = parameters.update()
        >>> integrator = mi.load_dict({"type": "mesh_normals", "channels": "mask"})
        >>> image = mi.render(scene, parameters, integrator=integrator, spp=1)
        >>> image.shape
        (16, 16, 1)
        >>> dr.backward(dr.sum(image, axis=None))
        >>> grad = dr.unravel(mi.Vector3f, dr.grad(parameters["cube.vertex_positions"]))
        >>> dr.sum(grad.z)[0] < 0  # the silhouette shrinks as the cube moves away
        True
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.channels = Channels.parse(
            str(props.get("channels", "normal, mask")), str(props.get("space", "camera"))
        )
        self.edge_density = float(props.get("edge_density", 4.0))
        self.intersections = bool(props.get("intersections", True))
        self.flat_faces = bool(props.get("flat_faces", True))
        self.pixel_aspect = float(props.get("pixel_aspect", 1.0))
        for name in ("edge_density", "pixel_aspect"):
            if not getattr(self, name) > 0:
                raise ValueError(f"mesh_normals: {name} must be positive")
        self._topology: Topology | None = None

    def view(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        spp: int = 1,
        tiles: Sequence[Tile] = (),
        instanced: mi.Mesh | None = None,
        projection: SensorProjection | None = None,
    ) -> MeshView:
        """Return a sensor's image and its derivatives, without automatic differentiation.

        Args:
            scene: the meshes.
            sensor: the view.
            spp: rays per pixel.
            tiles: parts of the view to render instead of it, at one ray per pixel. The image then
                has one row, with the pixels of one tile after the other. Edges have as many samples
                as in a picture of the finest tile.
            instanced: the only mesh, if the scene holds it as an instance that is not transformed.
            projection: the sensor's projection, if it is known already.

        Raises:
            ValueError: a shape is no mesh, or the sensor or the film cannot be used.
        """
        if spp < 1:
            raise ValueError(f"mesh_normals: spp must be at least 1, got {spp}")
        with dr.suspend_grad():
            meshes = _meshes_of(scene) if instanced is None else [instanced]
            buffers = [dr.detach(mesh.vertex_positions_buffer()) for mesh in meshes]
            positions = _joined([dr.unravel(mi.Vector3f, x) for x in buffers])
            surface = self._surface(meshes, positions)
            projection = projection or SensorProjection.of(sensor, self.pixel_aspect)
            film = sensor.film()
            filter = MultiCrop.of(tiles, film) if tiles else PixelFilter.of(film, spp)
            traced = _without_ellipsoids(scene) if instanced is None else scene
            caster = RayCaster(traced, surface, projection, self.channels)
            density = self.edge_density * max((tile.scale for tile in tiles), default=1.0)
            return MeshView.of(caster, filter, density, self.intersections)

    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Render the image, (H, W, C)."""
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
        """Return the derivative of the image (H, W, C) along the parameters' gradients."""
        sensor, spp = _arguments(scene, sensor, spp)
        buffers = [mesh.vertex_positions_buffer() for mesh in _meshes_of(scene)]
        to_world = sensor.world_transform().matrix
        dr.forward_to([x for x in (*buffers, to_world) if dr.grad_enabled(x)])
        moves = [dr.unravel(mi.Vector3f, dr.grad(buffer)) for buffer in buffers]
        d_to_world = mi.Matrix4f(dr.grad(to_world)) if dr.grad_enabled(to_world) else None
        with dr.suspend_grad():
            return self.view(scene, sensor, spp).tangent(_joined(moves), d_to_world)

    def render_backward(
        self,
        scene: mi.Scene,
        params: mi.SceneParameters,
        grad_in: mi.TensorXf,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> None:
        """Propagate the image's gradient (H, W, C) to the gradients of the parameters."""
        sensor, spp = _arguments(scene, sensor, spp)
        to_world = sensor.world_transform().matrix
        with dr.suspend_grad():
            view = self.view(scene, sensor, spp)
            grad = view.adjoint(grad_in)
            dr.eval(grad)
        start = 0
        for mesh in _meshes_of(scene):
            count, buffer = mesh.vertex_count(), mesh.vertex_positions_buffer()
            index = dr.arange(mi.UInt32, count) + start
            start += count
            with dr.resume_grad():
                if dr.grad_enabled(buffer):
                    dr.backward(buffer * dr.ravel(dr.gather(mi.Vector3f, grad, index)))
        with dr.resume_grad():
            if dr.grad_enabled(to_world):
                by_sensor = view.adjoint_to_world(grad_in, grad)
                dr.backward(
                    sum(to_world[i, j] * by_sensor[i, j] for i in range(3) for j in range(4))
                )

    def sample(self, *args: object, **kwargs: object) -> NoReturn:
        """Refuse single rays, which ``aov`` and ``moment`` ask of the integrator inside them."""
        raise ValueError(
            "mesh_normals: draws whole images and no single rays, therefore it cannot be inside "
            "'aov' or 'moment': render it alone"
        )

    def aov_names(self) -> list[str]:
        """Names of the channels."""
        return self.channels.names

    def to_string(self) -> str:
        """Return the text that Mitsuba prints."""
        return (
            f"MeshNormals[channels={', '.join(self.channels.kinds)}, space={self.channels.space}, "
            f"edge_density={self.edge_density}, intersections={self.intersections}, "
            f"flat_faces={self.flat_faces}, pixel_aspect={self.pixel_aspect}]"
        )

    def _surface(self, meshes: list[mi.Mesh], positions: mi.Vector3f) -> MeshSurface:
        """Return the meshes at a place; the topology is built again only when it has changed."""
        topology = self._topology
        earlier = {} if topology is None else {mesh.key: mesh for mesh in topology.welds}
        welds = tuple(Welds.of(mesh, earlier) for mesh in meshes)
        if topology is None or welds != topology.welds:
            topology = Topology.of(welds)
        surface = MeshSurface.of(topology, positions)
        flat = surface.flat_faces() if self.flat_faces else topology.flat
        longest = surface.longest_sides(flat)
        same = np.array_equal(flat, topology.flat) and np.array_equal(longest, topology.longest)
        self._topology = topology if same else Topology.of(welds, flat, longest)
        return replace(surface, topology=self._topology)


def _meshes_of(scene: mi.Scene) -> list[mi.Mesh]:
    """Return a scene's shapes except ellipsoids; all of them must be meshes.

    Raises:
        ValueError: a shape is no mesh, or there is none.
    """
    meshes = [shape for shape in scene.shapes() if not shape.is_ellipsoids()]
    for shape in meshes:
        if not shape.is_mesh():
            raise ValueError(
                "mesh_normals: every shape must be a triangle mesh, "
                f"'{shape.id()}' is {shape.class_name()}"
            )
    if not meshes:
        raise ValueError("mesh_normals: the scene has no mesh")
    return meshes


def _without_ellipsoids(scene: mi.Scene) -> mi.Scene:
    """Return a scene for ray tracing: the scene itself, or a new one of its meshes alone.

    A scene with ellipsoids can be used by both plugins. Rays would end at the ellipsoids, so the
    meshes become a scene of their own. It is built again for every picture, because only the first
    scene is notified when meshes move.
    """
    if not any(shape.is_ellipsoids() for shape in scene.shapes()):
        return scene
    meshes = {f"mesh{k}": mesh for k, mesh in enumerate(_meshes_of(scene))}
    return mi.load_dict({"type": "scene", **meshes})


def _arguments(scene: mi.Scene, sensor: mi.Sensor | int, spp: int) -> tuple[mi.Sensor, int]:
    sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
    return sensor, spp or sensor.sampler().sample_count()


def _joined(values: list[mi.Vector3f]) -> mi.Vector3f:
    if len(values) == 1:
        return values[0]
    return mi.Vector3f([dr.concat([value[k] for value in values]) for k in range(3)])
