"""The references of the gradient check, through the sensors of the tests."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest


@pytest.fixture(scope="session")
def references(scenes):
    """References of the derivative; imported once Mitsuba has its variant."""
    from gva_mi.gradcheck import moving_mesh, scanlines

    return SimpleNamespace(MovingMesh=moving_mesh.MovingMesh, lens=MeasuredLens.of,
        interior=moving_mesh.interior, boundary=scanlines.boundary,
        upper_envelope=scanlines.upper_envelope)  # fmt: skip


@dataclass(frozen=True)
class MeasuredLens:
    """A sensor as its own rays show it, in float64; the interface of ``PinholeLens``.

    With ``a, b`` the steps of a ray for a pixel to the right and down, and ``w`` the depth:
    ``x = eye + w (a q_x + b q_y + c)`` for a pinhole, ``x = o + a q_x + b q_y + w axis`` for an
    orthographic sensor; ``c``, ``o`` belong to the ray of pixel (0, 0).
    """

    sensor: mi.Sensor
    size: tuple[int, int]
    parallel: bool
    place: np.ndarray
    rotation: np.ndarray
    origin: np.ndarray
    inverse: np.ndarray

    @staticmethod
    def of(sensor):
        size = tuple(int(x) for x in sensor.film().crop_size())
        pose = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
        turn = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)
        place, axis = pose[:3, 3], turn[:, 2]
        ray, _ = sensor.sample_ray(0, 0, mi.Point2f([0, 1, 0], [0, 0, 1]), mi.Point2f(0.5))
        o, d = (np.broadcast_to(np.array(v, np.float64).T, (3, 3)) for v in (ray.o, ray.d))
        parallel = sensor.class_name() == "OrthographicCamera"
        if parallel:
            start = o - ((o - place) @ axis)[:, None] * axis
            origin, last = start[0], axis
        else:
            start = d / (d @ axis)[:, None]
            origin, last = place, start[0]
        steps = ((start[k + 1] - start[0]) / size[k] for k in range(2))
        inverse = np.linalg.inv(np.stack([*steps, last], axis=1))
        # Mitsuba's camera looks along +z with x to the left and y up.
        rotation = turn * [-1, -1, 1]
        return MeasuredLens(sensor, size, parallel, place, rotation, origin, inverse)

    def project(self, x):
        q = (x - self.origin) @ self.inverse.T
        return q[:, :2] if self.parallel else q[:, :2] / q[:, 2:]

    def depth(self, x):
        return (x - self.place) @ self.rotation[:, 2]

    def scale(self, x):
        return np.ones(len(x)) if self.parallel else self.depth(x)

    def nearness(self, x):
        return -self.depth(x) if self.parallel else 1 / self.depth(x)

    def rays(self, q):
        at = mi.Point2f((q / self.size).T.astype(np.float32))
        ray, _ = self.sensor.sample_ray(0, 0, at, mi.Point2f(0.5))
        return (np.broadcast_to(np.array(v, np.float64).T, (len(q), 3)) for v in (ray.o, ray.d))
