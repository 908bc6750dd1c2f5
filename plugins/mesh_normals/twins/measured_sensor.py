"""A sensor as its own rays show it, in float64: what the slow twins look through.

Nothing is read of a lens but rays that Mitsuba's sensor shoots through corners of the film, so that
this shares no formula with the integrator's ``projection.py``. With ``a, b`` the steps of a ray for
a pixel to the right and down, and ``w`` the depth along the axis:

1. pinhole        ``x = eye + w (a q_x + b q_y + c)``, ``c`` the ray of pixel (0, 0),
2. orthographic   ``x = o + a q_x + b q_y + w axis``, ``o`` the start of the ray of pixel (0, 0).

Both are solved for pixel and depth by one matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np


@dataclass(frozen=True)
class MeasuredSensor:
    """Where a sensor sees points of the world."""

    width: int  # pixels of the crop window
    height: int
    parallel: bool  # orthographic, else a pinhole
    place: np.ndarray  # (3,) of the sensor, world
    axis: np.ndarray  # (3,) unit vector along which depth grows
    rotation: np.ndarray  # (3, 3) columns: x right, y down, z forward in the world
    origin: np.ndarray  # (3,) eye, or o
    inverse: np.ndarray  # (3, 3) of the matrix with columns a, b and c (or the axis)

    @staticmethod
    def of(sensor: mi.Sensor) -> MeasuredSensor:
        """Shoot three rays."""
        width, height = (int(x) for x in sensor.film().crop_size())
        pose = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
        turn = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)
        place, axis = pose[:3, 3], turn[:, 2]
        corners = mi.Point2f([0, 1, 0], [0, 0, 1])
        ray, _ = sensor.sample_ray(0, 0, corners, mi.Point2f(0.5))
        o, d = (np.broadcast_to(np.array(v, np.float64).T, (3, 3)) for v in (ray.o, ray.d))
        parallel = sensor.class_name() == "OrthographicCamera"
        if parallel:
            start = o - ((o - place) @ axis)[:, None] * axis
            origin, last = start[0], axis
        else:
            start = d / (d @ axis)[:, None]
            origin, last = place, start[0]
        sides = np.stack(
            [(start[1] - start[0]) / width, (start[2] - start[0]) / height, last], axis=1
        )
        # Mitsuba's camera looks along +z with x to the left and y up.
        rotation = turn * [-1, -1, 1]
        inverse = np.linalg.inv(sides)
        return MeasuredSensor(
            width, height, parallel, place, axis, rotation, origin, inverse
        )  # fmt: skip

    def project(self, x: np.ndarray) -> np.ndarray:
        """Pixel positions (N, 2) of world points (N, 3)."""
        q = (x - self.origin) @ self.inverse.T
        return q[:, :2] if self.parallel else q[:, :2] / q[:, 2:]

    def depth(self, x: np.ndarray) -> np.ndarray:
        """Distance from the sensor's plane, (N,)."""
        return (x - self.place) @ self.axis

    def scale(self, x: np.ndarray) -> np.ndarray:
        """What pixel positions are divided by: a pinhole's depth (N,); 1 in parallel projection."""
        return np.ones(len(x)) if self.parallel else self.depth(x)

    def nearness(self, x: np.ndarray) -> np.ndarray:
        """A measure (N,) that grows toward the sensor and is affine on the image of a plane."""
        return -self.depth(x) if self.parallel else 1 / self.depth(x)
