"""Conversion of a Mitsuba sensor to a camera of ``gva_mi.splat``, differentiable.

A Mitsuba sensor looks along +z, with x to the left and y up: F = diag(-1, -1, 1) makes that OpenCV.
With ``to_world = [M | o]``, the film's size (W, H) and the corner of its crop window, in pixels:

1. M = R diag(s)                                  s = 1 for perspective, which may not be scaled
2. T_camera_world = [F R⁻¹ | -F R⁻¹ o]
3. f = W / (2 tan(x_fov / 2))                     perspective
   f = (W / 2 s₀, W / 2 s₁)                       orthographic, pixels per metre
4. c = (W, H) / 2 - corner - (W, H) · offset      offset: principal_point_offset of perspective
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gva_mi.splat import Camera

RIGID = 1e-4  # by how much R may fail to be orthonormal


@dataclass(frozen=True)
class SensorCamera:
    """A sensor's camera, its axis and its clip distances."""

    camera: Camera  # holds tensors attached to the sensor's parameters if one has a gradient
    axis: list[mi.Float]  # viewing direction: a unit vector of the world
    near: float  # m
    far: float  # m

    @staticmethod
    def of(sensor: mi.Sensor) -> SensorCamera:
        """Convert a ``perspective`` or ``orthographic`` sensor.

        Raises:
            ValueError: another kind of sensor, or a sheared to_world.
        """
        parameters, film = mi.traverse(sensor), sensor.film()
        to_world, size = sensor.world_transform().matrix, film.size()
        M = mi.Matrix3f([[to_world[i, j] for j in range(3)] for i in range(3)])
        c = [size[i] / 2 - film.crop_offset()[i] for i in range(2)]
        if sensor.class_name() == "PerspectiveCamera":
            model, s = "pinhole", mi.Vector3f(1)
            f = [size[0] / 2 / dr.tan(dr.deg2rad(parameters["x_fov"]) / 2)] * 2
            offsets = [parameters[f"principal_point_offset_{axis}"] for axis in "xy"]
            c = [c[i] - size[i] * offsets[i] for i in range(2)]
        elif sensor.class_name() == "OrthographicCamera":
            model = "ortho"
            columns = [mi.Vector3f(M[0, j], M[1, j], M[2, j]) for j in range(3)]
            s = mi.Vector3f([dr.norm(column) for column in columns])
            f = [size[0] / 2 / s[i] for i in range(2)]
        else:
            raise ValueError(
                "gaussian_splat: the sensor must be 'perspective' or 'orthographic', got "
                f"{sensor.class_name()}"
            )
        flip = mi.Matrix3f([[-1, 0, 0], [0, -1, 0], [0, 0, 1]])
        R = flip @ dr.rcp(M @ dr.diag(1 / s))
        t = -(R @ mi.Vector3f(*(to_world[i, 3] for i in range(3))))
        T = _tensor([*([*(R[i, j] for j in range(3)), t[i]] for i in range(3)), [0, 0, 0, 1]])
        K = _tensor([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1]])

        dr.eval(T, K, s)
        attached = dr.grad_enabled(T, K)
        matrices = (K, T) if attached else (dr.detach(x).numpy() for x in (K, T))
        rotation = dr.detach(T).numpy().astype(np.float64)[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=RIGID):
            raise ValueError("gaussian_splat: the sensor's to_world must not be sheared")
        camera = Camera.from_matrices(*matrices, *film.crop_size(), model)
        axis = [dr.gather(mi.Float, T.array, 8 + j) for j in range(3)]
        along_z = float(dr.detach(s.z)[0])
        near, far = along_z * sensor.near_clip(), along_z * sensor.far_clip()
        return SensorCamera(camera, axis, near, far)


def _tensor(rows: list[list[mi.Float | float]]) -> mi.TensorXf:
    numbers = [mi.Float(x) for row in rows for x in row]
    return mi.TensorXf(dr.concat(numbers), (len(rows), len(rows[0])))
