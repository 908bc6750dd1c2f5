"""Picture and depth of all shapes of a scene except ellipsoids.

A ray tracer cannot ignore the ellipsoids of a scene. So the other shapes become a scene of their
own, which shares shapes, materials and emitters with the first. It is built again for every
picture, with a new BVH, because shapes may have moved and only the first scene is notified.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gva_mi.splat import Camera


@dataclass(frozen=True)
class OtherShapes:
    """All shapes of a scene except ellipsoids, with the scene's emitters and a sensor."""

    scene: mi.Scene
    sensor: mi.Sensor

    @staticmethod
    def of(scene: mi.Scene, sensor: mi.Sensor) -> OtherShapes:
        """Collect the shapes of a scene that are not ellipsoids.

        Raises:
            ValueError: there are none.
        """
        shapes = [shape for shape in scene.shapes() if not shape.is_ellipsoids()]
        if not shapes:
            raise ValueError("gaussian_splat: meshes is 'depth', and the scene has no mesh")
        emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
        parts = {f"part{i}": part for i, part in enumerate([*shapes, *emitters, sensor])}
        others = mi.load_dict({"type": "scene", **parts})
        for emitter in emitters:  # an environment encloses the scene that took it in last
            emitter.set_scene(scene)
        return OtherShapes(others, sensor)

    def image(self, integrator: mi.Integrator, seed: int, spp: int) -> mi.TensorXf:
        """Render the shapes, (H, W, 3 or 4), with an integrator and its own derivatives."""
        params = mi.traverse(self.scene)
        image = mi.render(self.scene, params, self.sensor, integrator, seed=seed, spp=spp)
        if image.shape[2] not in (3, 4):
            raise ValueError(
                "gaussian_splat: where meshes is 'depth', film and nested integrator must make RGB "
                f"or RGBA images, got {image.shape[2]} channels"
            )
        return image

    def depth(self, camera: Camera) -> mi.TensorXf:
        """Depth (H, W) m along the camera's z of the surface at each pixel's centre.

        Infinite where there is no surface. Not differentiable.
        """
        width, height = camera.width, camera.height
        with dr.suspend_grad():
            pixel = dr.arange(mi.UInt32, width * height)
            row = pixel // width
            center = (mi.Point2f(pixel - row * width, row) + 0.5) / mi.Point2f(width, height)
            ray, _ = self.sensor.sample_ray(0, 0, center, mi.Point2f(0.5))
            found = self.scene.ray_intersect_preliminary(ray, coherent=True)
            axis = mi.Vector3f(camera.T_camera_world[2, :3].tolist())
            z = dr.dot(axis, ray(found.t)) + float(camera.T_camera_world[2, 3])
            return mi.TensorXf(dr.select(found.is_valid(), z, dr.inf), (height, width))
