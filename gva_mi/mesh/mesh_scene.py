"""From a body and a camera to an image of normals and mask, differentiable in torch.

The body stands in a Mitsuba scene as one mesh, and the plugin ``mesh_normals`` looks at it
(interior and boundary gradients). A ``Camera`` becomes a Mitsuba sensor:

1. Mitsuba's camera looks along +z with x to the left and y up:
   ``to_world = T_camera_world^{-1} · diag(-1, -1, 1, 1)``,
2. field of view in x: ``2 atan(W / (2 fx))``,
3. principal point: offsets ``(W / 2 - cx) / W`` and ``(H / 2 - cy) / H``,
4. ``fy / fx`` is left to the plugin's ``pixel_aspect``: Mitsuba's pixels are square.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.splat import Camera

if TYPE_CHECKING:
    import mitsuba as mi
    from gva_mi_plugins.mesh_normals.integrator import View

NEAR, FAR = 0.01, 1000.0  # metres


class BodyScene:
    """One mesh that is moved about and looked at.

    Example:
        >>> scene = BodyScene(body.faces, vertices)  # doctest: +SKIP
        >>> image = scene.render(vertices, camera)  # (H, W, 4), differentiable in the vertices
    """

    def __init__(self, faces: Tensor, vertices: Tensor) -> None:
        """Build the mesh.

        Args:
            faces: (F, 3) integers, counter-clockwise seen from outside.
            vertices: (V, 3) any positions; those of vertices that are one point must be equal here.
        """
        import gva_mi_plugins
        import mitsuba as mi

        if mi.variant() is None:
            mi.set_variant("llvm_ad_rgb")
        gva_mi_plugins.register()
        mesh = mi.Mesh("body", len(vertices), len(faces))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = _to_mitsuba(vertices)
        parameters["faces"] = mi.UInt32(faces.to(torch.int32).flatten().numpy().astype(np.uint32))
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "body": mesh})
        self._parameters = mi.traverse(self._scene)
        self._sensors: dict[tuple, tuple[Any, Any]] = {}
        self._shown: Tensor | None = None
        self.vertex_count = len(vertices)

    def render(self, vertices: Tensor, camera: Camera) -> Tensor:
        """Normals in camera space (OpenCV axes) and mask, seen at the centres of the pixels.

        Args:
            vertices: (V, 3) float32, world, metres.
            camera: the view.

        Returns:
            (H, W, 4), zero where there is no body; differentiable in the vertices.
        """
        if vertices.shape != (self.vertex_count, 3) or vertices.dtype != torch.float32:
            raise ValueError(
                f"BodyScene.render(): vertices must be ({self.vertex_count}, 3) float32, "
                f"got {tuple(vertices.shape)} {vertices.dtype}"
            )
        return _RenderNormals.apply(vertices, self, camera)

    def view(self, vertices: Tensor, camera: Camera) -> View:
        """The plugin's view of the body at these vertices."""
        self.show(vertices)
        integrator, sensor = self._sensor(camera)
        return integrator.view(self._scene, sensor)

    def show(self, vertices: Tensor) -> None:
        """Move the mesh there; rebuilding the ray tracer's tree is most of a rendering's time."""
        if self._shown is not vertices:
            self._parameters["body.vertex_positions"] = _to_mitsuba(vertices)
            self._parameters.update()
            self._shown = vertices

    def _sensor(self, camera: Camera) -> tuple[Any, Any]:
        """The integrator and the sensor of a camera, kept, for a video has few."""
        import mitsuba as mi

        key = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        key += (camera.T_camera_world.tobytes(),)
        if key not in self._sensors:
            integrator = {
                "type": "mesh_normals",
                "pixel_aspect": camera.fy / camera.fx,
                # Where a body is pressed into itself is searched for at a fifth of a step's cost,
                # and there is little of it.
                "piercing": False,
            }
            self._sensors[key] = mi.load_dict(integrator), mi.load_dict(sensor_of(camera))
        return self._sensors[key]


def sensor_of(camera: Camera) -> dict[str, Any]:
    """A camera as a dictionary for ``mi.load_dict`` (eq. 1-3)."""
    import mitsuba as mi

    width, height = camera.width, camera.height
    to_world = np.linalg.inv(camera.T_camera_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(width / (2 * camera.fx)))),
        "principal_point_offset_x": (width / 2 - camera.cx) / width,
        "principal_point_offset_y": (height / 2 - camera.cy) / height,
        "near_clip": NEAR,
        "far_clip": FAR,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
        },
    }


class _RenderNormals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, vertices: Tensor, scene: BodyScene, camera: Camera) -> Tensor:
        shown = vertices.detach().contiguous()
        ctx.scene, ctx.shown = scene, shown
        ctx.view = scene.view(shown, camera)
        return _to_torch(ctx.view.image())

    @staticmethod
    def backward(ctx: FunctionCtx, grad_image: Tensor) -> tuple[Tensor, None, None]:
        import drjit as dr
        import mitsuba as mi

        ctx.scene.show(ctx.shown)  # where another pose was looked at in between
        grad = ctx.view.adjoint(mi.TensorXf(grad_image.contiguous()))
        return _to_torch(dr.ravel(grad)).view(-1, 3), None, None


def _to_mitsuba(vertices: Tensor) -> mi.Float:
    """Without a copy: Dr.Jit keeps the tensor's memory alive."""
    import mitsuba as mi

    return mi.Float(vertices.detach().contiguous().view(-1))


def _to_torch(value: mi.TensorXf) -> Tensor:
    """Without a copy, once the kernels that compute it have ended."""
    import drjit as dr

    dr.eval(value)
    dr.sync_thread()
    return value.torch()
