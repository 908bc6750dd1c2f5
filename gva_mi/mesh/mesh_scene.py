"""Render normals and mask of a mesh through a camera, differentiable in torch.

One mesh stands in a Mitsuba scene, and the plugin ``mesh_normals`` renders it through the sensor
of a camera. The gradient with respect to the vertices has both terms, interior and
boundary.

A camera becomes a sensor:

1. Mitsuba's camera looks along +z with x to the left and y up:
   ``to_world = T_camera_world^{-1} · diag(-1, -1, 1, 1)``,
2. field of view in x: ``2 atan(W / (2 fx))``, in degrees,
3. principal point: offsets ``(W / 2 - cx) / W`` and ``(H / 2 - cy) / H``,
4. a crop of its picture on a grid with ``r`` times the focal length is a tile of the view, with its
   corner at ``c - c_tile / r``,
5. ``fy / fx`` is the ``pixel_aspect`` of ``mesh_normals``, because Mitsuba's pixels are square.

Mitsuba stores the angle as a float32 number of degrees and converts it back to a focal length,
which costs a rounding or two. Passing K instead would change pictures in their last bits.

:func:`seen_vertices` finds the vertices that are visible from given places. A vertex x is visible
from a place y if its surface faces y, ``n · (y - x) > 0``, and the straight line to y meets no
triangle. The line starts a little off the surface, so that the triangles around the vertex do not
hide it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.tensors import tensor_of, to_drjit
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat import Camera

if TYPE_CHECKING:
    import mitsuba as mi
    from gva_mi_plugins.mesh_normals.integrator import MeshNormals
    from gva_mi_plugins.mesh_normals.mesh_view import MeshView
    from gva_mi_plugins.mesh_normals.pixel_filter import Tile
    from gva_mi_plugins.mesh_normals.projection import SensorProjection

CACHED_SENSORS = 1000  # in the cache of a scene; chosen: more than a video has cameras
NEAR_CLIP, FAR_CLIP = 0.01, 1000.0  # metres; chosen: a video shows no person outside them


class MeshScene:
    """A mesh whose vertices move, rendered from any camera.

    Example:
        >>> from gva_mi.splat import look_at
        >>> faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> vertices = torch.cat([torch.zeros(1, 3), torch.eye(3)])  # of a tetrahedron
        >>> vertices = vertices.requires_grad_()
        >>> camera = Camera(24.0, 24.0, 8.0, 8.0, look_at((2, 2, 2), (0, 0, 0)), 16, 16)
        >>> image = MeshScene(faces, vertices).render(vertices, camera)
        >>> image.shape
        torch.Size([16, 16, 4])
        >>> image[8, 8].detach()  # the normal points toward the camera, and the mask is 1
        tensor([ 0.1031,  0.1031, -0.9893,  1.0000])
        >>> (grad,) = torch.autograd.grad(image[..., 3].sum(), vertices)
        >>> (grad * vertices).sum() > 0  # the silhouette grows with the mesh
        tensor(True)
    """

    def __init__(self, faces: Tensor, vertices: Tensor) -> None:
        """Build the mesh.

        Args:
            faces: (F, 3) integers, counter-clockwise seen from outside.
            vertices: (V, 3) any positions.
        """
        load_plugins()
        import mitsuba as mi

        self._mesh = _mesh_of(faces, vertices)
        # Mitsuba builds the ray tracer's tree four times as fast for an instance as for a scene:
        # with fewer cuts, while rays take as long. A ray in a million meets another triangle.
        group = {"type": "shapegroup", "mesh": self._mesh}
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "group": group,
                "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
            }
        )
        self._parameters = mi.traverse(self._scene)
        self._integrators: dict[tuple[float, str], MeshNormals] = {}
        # A video has few cameras, a browser has many.
        self._sensor = lru_cache(CACHED_SENSORS)(_sensor_and_projection)
        self._shown: Tensor | None = None
        self.vertex_count = len(vertices)

    def render(self, vertices: Tensor, camera: Camera, normals: bool = True) -> Tensor:
        """Render normals in camera space (OpenCV axes) and the mask, at the centres of the pixels.

        Args:
            vertices: (V, 3) float32, world, metres.
            camera: the view.
            normals: False: the mask alone, whose gradient costs half as much.

        Returns:
            (H, W, 4), or (H, W, 1) of the mask alone; zero beside the mesh; differentiable in the
            vertices.
        """
        pixels = self._pixels(vertices, camera, (), normals)
        return pixels.view(camera.height, camera.width, pixels.shape[-1])

    def render_crops(
        self, vertices: Tensor, picture: Camera, crops: Sequence[Camera], normals: bool = True
    ) -> list[Tensor]:
        """Render several crops of one picture for little more than the cost of one picture.

        Args:
            vertices: (V, 3) float32, world, metres.
            picture: the camera of the whole picture.
            crops: cameras of its parts, each at a resolution of its own; parts beyond the picture
                have no gradient.
            normals: False: the mask alone.

        Returns:
            (H, W, 4) or (H, W, 1) of each crop.

        Raises:
            ValueError: the cameras are not crops of the picture.
        """
        pixels = self._pixels(vertices, picture, tuple(crops), normals)
        counts = [camera.width * camera.height for camera in crops]
        shapes = [(camera.height, camera.width, pixels.shape[-1]) for camera in crops]
        return [x.view(shape) for x, shape in zip(pixels.split(counts), shapes, strict=True)]

    def tangents(self, vertices: Tensor, camera: Camera, motions: Tensor) -> Iterator[Tensor]:
        """Yield how the picture (H, W, 4) of :meth:`render` changes, one motion after the other.

        Args:
            vertices: (V, 3) float32, world, metres.
            camera: the view.
            motions: (P, V, 3) directions in which the vertices move.
        """
        import mitsuba as mi

        columns = (mi.Vector3f(dx.mT.float().contiguous().numpy()) for dx in motions)
        yield from map(tensor_of, self.view(vertices, camera).tangents(columns))

    def _pixels(
        self, vertices: Tensor, picture: Camera, crops: tuple[Camera, ...], normals: bool
    ) -> Tensor:
        """Return the pixels (N, C) of one crop after the other, or of the picture without any."""
        if vertices.shape != (self.vertex_count, 3) or vertices.dtype != torch.float32:
            raise ValueError(
                f"MeshScene.render(): vertices must be ({self.vertex_count}, 3) float32, "
                f"got {tuple(vertices.shape)} {vertices.dtype}"
            )
        return _RenderNormals.apply(vertices, self, picture, crops, normals)

    def view(
        self, vertices: Tensor, picture: Camera, crops: Sequence[Camera] = (), normals: bool = True
    ) -> MeshView:
        """Return the plugin's view of the mesh, in tiles if there are crops."""
        import mitsuba as mi

        self.show(vertices)
        (sensor, projection), aspect = self._sensor(picture), pixel_aspect(picture)
        key = aspect, "normal, mask" if normals else "mask"
        if key not in self._integrators:  # each keeps the mesh's topology
            # To search where a body intersects itself costs a fifth of a step, for few pixels. Thin
            # faces of a body remain faces, so that its edges stay the same in all frames.
            kind = {"type": "mesh_normals", "pixel_aspect": aspect, "channels": key[1]}
            kind |= {"intersections": False, "flat_faces": False}
            self._integrators[key] = mi.load_dict(kind)
        tiles = [tile_of(crop, picture) for crop in crops]
        return self._integrators[key].view(
            self._scene, sensor, tiles=tiles, instanced=self._mesh, projection=projection
        )

    def show(self, vertices: Tensor) -> None:
        """Move the mesh to these vertices (V, 3), if they are not the last ones.

        The ray tracer's tree is built again, which takes a good part of a rendering's time.
        """
        import mitsuba as mi

        if self._shown is not vertices:
            self._parameters["group.mesh.vertex_positions"] = to_drjit(vertices, mi.Float)
            self._parameters.update()
            self._shown = vertices


def load_plugins() -> None:
    """Register the plugins; set the variant ``llvm_ad_rgb`` if none is set.

    Example:
        >>> load_plugins()
        >>> import mitsuba as mi
        >>> mi.variant()
        'llvm_ad_rgb'
    """
    import gva_mi_plugins
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    gva_mi_plugins.register()


def _sensor_and_projection(camera: Camera) -> tuple[mi.Sensor, SensorProjection]:
    import mitsuba as mi
    from gva_mi_plugins.mesh_normals.projection import SensorProjection

    sensor = mi.load_dict(sensor_of(camera))
    return sensor, SensorProjection.of(sensor, pixel_aspect(camera))


def scene_of(faces: Tensor, vertices: Tensor) -> mi.Scene:
    """Return a scene of one shape, ``mesh``, with faces (F, 3) and float32 vertices (V, 3).

    Example:
        >>> load_plugins()
        >>> scene = scene_of(torch.tensor([[0, 1, 2]]), torch.eye(3))
        >>> scene.shapes()[0].face_count()
        1
    """
    import mitsuba as mi

    return mi.load_dict({"type": "scene", "mesh": _mesh_of(faces, vertices)})


def _mesh_of(faces: Tensor, vertices: Tensor) -> mi.Mesh:
    """Return the shape of :func:`scene_of`."""
    import mitsuba as mi

    mesh = mi.Mesh("mesh", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = to_drjit(vertices, mi.Float)
    parameters["faces"] = mi.UInt32(faces.to(torch.int32).flatten().numpy().astype(np.uint32))
    parameters.update()
    return mesh


class _RenderNormals(torch.autograd.Function):
    """Autograd function that renders the pixels (N, C) of :meth:`MeshScene._pixels`."""

    @staticmethod
    def forward(
        ctx: FunctionCtx,
        vertices: Tensor,
        scene: MeshScene,
        picture: Camera,
        crops: tuple[Camera, ...],
        normals: bool,
    ) -> Tensor:
        shown = vertices.detach().contiguous()
        ctx.scene, ctx.shown = scene, shown
        ctx.view = scene.view(shown, picture, crops, normals)
        image = ctx.view.image()
        ctx.shape = image.shape
        return tensor_of(image).flatten(0, 1)

    @staticmethod
    def backward(ctx: FunctionCtx, grad_pixels: Tensor) -> tuple[Tensor | None, ...]:
        import drjit as dr
        import mitsuba as mi

        ctx.scene.show(ctx.shown)  # another pose may have been rendered in between
        grad = ctx.view.adjoint(mi.TensorXf(grad_pixels.contiguous().view(ctx.shape)))
        return tensor_of(dr.ravel(grad)).view(-1, 3), None, None, None, None


def sensor_of(camera: Camera) -> dict[str, Any]:
    """Return a pinhole camera as a dictionary for ``mi.load_dict`` (eq. 1-3).

    The sensor's pixels are square: pass :func:`pixel_aspect` to the integrator.

    Raises:
        ValueError: another model of camera.

    Example:
        >>> load_plugins()
        >>> sensor = sensor_of(Camera(8.0, 8.0, 8.0, 6.0, np.eye(4), 16, 16))
        >>> round(sensor["fov"], 3), sensor["principal_point_offset_y"]
        (90.0, 0.125)
    """
    import mitsuba as mi

    if camera.model != "pinhole":
        raise ValueError(f"sensor_of(): the camera must be a pinhole, got {camera.model}")

    width, height = camera.width, camera.height
    to_world = np.linalg.inv(camera.T_camera_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(width / (2 * camera.fx)))),
        "principal_point_offset_x": (width / 2 - camera.cx) / width,
        "principal_point_offset_y": (height / 2 - camera.cy) / height,
        "near_clip": NEAR_CLIP,
        "far_clip": FAR_CLIP,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


def pixel_aspect(camera: Camera) -> float:
    """Return the width of a pixel over its height (eq. 5).

    Example:
        >>> pixel_aspect(Camera(10.0, 12.0, 8.0, 8.0, np.eye(4), 16, 16))
        1.2
    """
    return camera.fy / camera.fx


def tile_of(crop: Camera, whole: Camera) -> Tile:
    """Return the tile of a view that is the picture of another camera (eq. 4).

    Raises:
        ValueError: the other camera has another pose, or pixels of another aspect.

    Example:
        >>> load_plugins()
        >>> whole = Camera(8.0, 8.0, 8.0, 8.0, np.eye(4), 16, 16)
        >>> crop = Camera(16.0, 16.0, 4.0, 4.0, np.eye(4), 8, 8)  # the middle, twice as large
        >>> tile_of(crop, whole)
        Tile(left=6.0, top=6.0, scale=2.0, width=8, height=8)
    """
    from gva_mi_plugins.mesh_normals.pixel_filter import Tile

    same = np.array_equal(crop.T_camera_world, whole.T_camera_world) and crop.model == whole.model
    if not same or not math.isclose(pixel_aspect(crop), pixel_aspect(whole), rel_tol=1e-9):
        raise ValueError("tile_of(): the cameras must see crops of one picture")
    scale = crop.fx / whole.fx
    left, top = whole.cx - crop.cx / scale, whole.cy - crop.cy / scale
    return Tile(float(left), float(top), float(scale), crop.width, crop.height)


# Metres off the surface at which a line starts. Chosen: above float32's rounding of positions,
# below the distance between parts of a body.
VISIBILITY_RAY_OFFSET = 0.002
# Share of the way to the viewpoint that is tested. Chosen: a surface at the viewpoint itself hides
# nothing.
TESTED_SHARE = 0.999


def seen_vertices(vertices: Tensor, faces: Tensor, viewpoints: np.ndarray) -> Tensor:
    """Return whether vertices are visible from each of E viewpoints (E, 3), (E, V) bool.

    Faces are counter-clockwise seen from outside; the edges of pictures are ignored.

    Example:
        >>> faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> vertices = torch.cat([torch.zeros(1, 3), torch.eye(3)])  # of a tetrahedron
        >>> seen_vertices(vertices, faces, np.array([[2.0, 2.0, 2.0], [-2.0, -2.0, -2.0]]))
        tensor([[False,  True,  True,  True],
                [ True, False, False, False]])
    """
    load_plugins()
    import mitsuba as mi

    vertices = vertices.detach().float()
    normals = vertex_normals(vertices, faces)
    start, scene = vertices + VISIBILITY_RAY_OFFSET * normals, scene_of(faces, vertices)
    columns = lambda x: np.ascontiguousarray(x.T.numpy(), np.float32)
    seen = []
    for viewpoint in torch.from_numpy(np.asarray(viewpoints, dtype=np.float32)):
        toward = viewpoint - start
        distance = toward.norm(dim=1, keepdim=True)
        ray = mi.Ray3f(mi.Point3f(columns(start)), mi.Vector3f(columns(toward / distance)))
        ray.maxt = mi.Float((TESTED_SHARE * distance[:, 0]).numpy())
        hidden = torch.from_numpy(np.array(scene.ray_test(ray), dtype=bool))
        seen.append(((normals * toward).sum(1) > 0) & ~hidden)
    return torch.stack(seen)
