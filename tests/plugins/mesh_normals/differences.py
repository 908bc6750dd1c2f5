"""The derivative of a whole image by differences, seen through any Mitsuba sensor.

``(I(x + ε dx) - I(x - ε dx)) / 2 ε`` with many rays in each pixel. Less the interior part
(gva_mi.gradcheck.interior) it is the boundary part. Nothing is shared with the plugin.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from gva_mi.mesh.mesh_scene import scene_of

GOLDEN = 0.6180339887498949


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
        ray = self.ray(mi.Point2f(q.T.astype(np.float32)))
        return (np.broadcast_to(np.array(v, np.float64).T, (len(q), 3)) for v in (ray.o, ray.d))

    def ray(self, q):
        at = mi.Point2f(q.x / self.size[0], q.y / self.size[1])
        return self.sensor.sample_ray(0, 0, at, mi.Point2f(0.5))[0]


def total(mesh, lens, step, rays):
    """The derivative of the image, (H, W, 5): normal in camera space, mask, depth.

    Args:
        mesh: a MovingMesh.
        lens: a MeasuredLens.
        step: ε.
        rays: for a pixel. They lie on a lattice that is shifted at random in each pixel, so that no
            edge runs along its rows.
    """
    low, high = mesh.window(lens, step)
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    width, height = lens.size
    pixels = mi.UInt32((y * width + x).ravel().astype(np.uint32))
    found = np.zeros((5, dr.width(pixels)))
    for sign in (1, -1):
        vertices = torch.from_numpy(mesh.at(sign * step).astype(np.float32))
        scene = scene_of(torch.from_numpy(mesh.faces), vertices)
        corners = mesh.corner_normals(sign * step) @ lens.rotation
        normals = mi.Vector3f(corners.reshape(-1, 3).T)
        summed = [dr.zeros(mi.Float64, dr.width(pixels)) for _ in range(5)]
        for k in range(rays):
            values, hit = _seen(scene, normals, lens, _lattice(pixels, width, k, rays))
            pairs = zip(summed, values, strict=True)
            summed = [s + mi.Float64(dr.select(hit, value, 0)) for s, value in pairs]
            dr.eval(summed)
        found += sign * np.array(summed) / (2 * step * rays)
    image = np.zeros((width * height, 5))
    image[np.array(pixels)] = found.T
    return image.reshape(height, width, 5)


def _seen(scene, normals, lens, q):
    """Normal, mask and depth along rays, and whether they hit the mesh."""
    ray = lens.ray(q)
    found = scene.ray_intersect_preliminary(ray, coherent=False)
    hit, u = found.is_valid(), found.prim_uv
    corner = [dr.gather(mi.Vector3f, normals, 3 * found.prim_index + j, hit) for j in range(3)]
    n = corner[0] * (1 - u.x - u.y) + corner[1] * u.x + corner[2] * u.y
    axis, place = mi.Vector3f(lens.rotation[:, 2]), mi.Vector3f(lens.place)
    depth = dr.dot(mi.Vector3f(ray(found.t)) - place, axis)
    return (*(n / dr.norm(n)), mi.Float(1), depth), hit


def _lattice(pixel, width, k, rays):
    """Place of ray ``k`` in each pixel."""
    k, step = dr.opaque(mi.Float, k), dr.opaque(mi.Float, 1 / rays)
    x = (k + 0.5) * step + mi.sample_tea_float32(pixel, 0)
    y = k * GOLDEN + mi.sample_tea_float32(pixel, 1)
    row = pixel // width
    return mi.Point2f(pixel - row * width + x - dr.floor(x), row + y - dr.floor(y))
