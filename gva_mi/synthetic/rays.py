"""Rays through the samples of a picture's pixels, and stratified random numbers for them."""

from __future__ import annotations

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat import Camera


def primary_rays(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """Return rays through image points (pixels), and their length per metre of depth."""
    import mitsuba as mi

    number = lambda x: dr.opaque(mi.Float, x)
    direction = mi.Vector3f(
        (x - number(camera.cx)) / number(camera.fx),
        (y - number(camera.cy)) / number(camera.fy),
        1.0,
    )
    per_depth = dr.norm(direction)
    T_world_camera = np.linalg.inv(camera.T_camera_world)
    R = [[number(float(T_world_camera[i, j])) for j in range(3)] for i in range(3)]
    turned = mi.Vector3f(
        *(R[i][0] * direction.x + R[i][1] * direction.y + R[i][2] * direction.z for i in range(3))
    )
    eye = mi.Point3f(*(number(float(x)) for x in T_world_camera[:3, 3]))
    return mi.Ray3f(eye, turned / per_depth), per_depth


class Strata:
    """Stratified points of the unit square: one per cell of an n × n grid over a pixel's samples.

    The cells are permuted for each call and pixel, so that dimensions do not correlate.
    """

    def __init__(self, random: Array, pixel: Array, sample: Array, n: int) -> None:
        self._random, self._pixel, self._sample, self._n = random, pixel, sample, n
        self._calls = 0

    def __call__(self) -> Array:
        import mitsuba as mi

        n = self._n
        self._calls += 1
        key = mi.sample_tea_32(self._pixel, self._calls, 3)[0]
        cell = mi.permute_kensler(self._sample, n * n, key)
        u = (mi.Float(cell % n) + self._random.next_float32()) / n
        v = (mi.Float(cell // n) + self._random.next_float32()) / n
        return mi.Point2f(u, v)


def window_of(vertices: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
    """Return the window of the picture that holds the vertices: left, top, width, height."""
    uv = camera.project(vertices.astype(np.float64))
    size = np.array([camera.width, camera.height])
    lo = np.clip(np.floor(uv.min(0)) - 1, 0, size - 1).astype(int)
    hi = np.clip(np.ceil(uv.max(0)) + 1, lo + 1, size).astype(int)
    return int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])


def beside(
    window: tuple[int, int, int, int], height: int, width: int
) -> list[tuple[int, int, int, int]]:
    """Return the parts of a picture around a window, each left, top, width, height."""
    left, top, wide, high = window
    right, bottom = left + wide, top + high
    parts = [
        (0, 0, width, top), (0, bottom, width, height - bottom),
        (0, top, left, high), (right, top, width - right, high),
    ]  # fmt: skip
    return [part for part in parts if min(part[2:]) > 0]
