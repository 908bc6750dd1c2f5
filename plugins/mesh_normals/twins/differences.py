"""The slow twin of ``mesh_normals``: its derivatives by differences, for checks.

It shares no code with the integrator: rays and projections come from Mitsuba's own sensor, normals
are computed in float64, and nothing is differentiated.

1. **Total**: ``(I(x + ε dx) - I(x - ε dx)) / 2 ε``, with many rays in each pixel.
2. **Interior**: the same where every point keeps to its triangle. Its integrand grows without bound
   toward contours, where surfaces are seen flat, as one over the cosine does: no good in the image.
   Points spread over the triangles see no such peak, for a triangle seen flat covers little:
   ``Σ_faces ∫ dI/dε |∂q/∂b| db`` over the points seen, ``b`` barycentric.
3. **Boundary**: the first minus the second.

Where contours lie closer to one another on the image than things move in a step, the first is off
by as much as they hide of one another: ``scanlines.py`` has no step.

Images are those of a box filter, (H, W, 5): normal in camera space, mask, depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.twins.measured_sensor import MeasuredSensor
from gva_mi_plugins.mesh_normals.twins.moving_mesh import (
    MovingMesh,
    corner_normals,
    joined_faces,
    joined_vertices,
    window,
)

GOLDEN = 0.6180339887498949
HIDDEN = 1e-4  # share of the distance by which what hides a point lies nearer


@dataclass(frozen=True)
class Differences:
    """Derivatives of an image of moving meshes by a step along their motion."""

    meshes: Sequence[MovingMesh]
    sensor: mi.Sensor

    @cached_property
    def lens(self) -> MeasuredSensor:
        """Where the sensor sees points."""
        return MeasuredSensor.of(self.sensor)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.lens.width, self.lens.height

    def total(self, step: float, rays: int) -> np.ndarray:
        """Eq. 1, (H, W, 5).

        Args:
            step: ε.
            rays: for a pixel. They lie on a lattice that is shifted at random in each pixel, lest
                edges run along its rows.
        """
        pixels = self._pixels(step)
        image = np.zeros((5, dr.width(pixels)))
        for sign in (1, -1):
            scene, faces = _scene(self.meshes, sign * step)
            normals = mi.Vector3f(self._corner_normals(sign * step).reshape(-1, 3).T)
            summed = [dr.zeros(mi.Float64, dr.width(pixels)) for _ in range(5)]
            for k in range(rays):
                ray = self._ray(self._lattice(pixels, k, rays))
                face, u, t, hit = _meet(scene, faces, ray)
                corner = [dr.gather(mi.Vector3f, normals, 3 * face + j, hit) for j in range(3)]
                n = corner[0] * (1 - u.x - u.y) + corner[1] * u.x + corner[2] * u.y
                n /= dr.norm(n)
                values = (*n, mi.Float(1), self._depth(ray(t)))
                summed = [
                    s + mi.Float64(dr.select(hit, value, 0))
                    for s, value in zip(summed, values, strict=True)
                ]
                dr.eval(summed)
            image += sign * np.array(summed) / (2 * step * rays)
        return self._unfold(image.T, np.array(pixels))

    def interior(self, step: float, points: int) -> np.ndarray:
        """Eq. 2, (H, W, 5), with some points on each face."""
        width, height = self.size
        scene, first = _scene(self.meshes, 0.0)
        p = self._corners(0.0)  # (F, 3, 3)
        moved = [(self._corners(s), self._corner_normals(s)) for s in (step, -step)]
        flat = p.reshape(-1, 3)
        q = self.lens.project(flat).reshape(-1, 3, 2)
        scale = self.lens.scale(flat).reshape(-1, 3)
        e1, e2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
        doubled = np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
        image = np.zeros((width * height, 5))
        for k in range(points):
            b1, b2 = (k + 0.5) / points, (0.5 + k * GOLDEN) % 1
            b1, b2 = (b1, b2) if b1 + b2 < 1 else (1 - b1, 1 - b2)
            b = np.array([1 - b1 - b2, b1, b2])
            x = np.einsum("k,fkc->fc", b, p)
            at = self.lens.project(x)
            ray = self._ray(mi.Point2f(at.T.astype(np.float32)))
            face, _, t, hit = (np.array(v) for v in _meet(scene, first, ray))
            distance = np.linalg.norm(x - np.array(ray.o).T, axis=1)
            seen = (hit & (face == np.arange(len(p)))) | (t > distance * (1 - HIDDEN))
            seen &= ((at >= 0) & (at < [width, height])).all(1)
            area = doubled * scale.prod(1) / self.lens.scale(x) ** 3 / (2 * points)
            o, d = (
                np.broadcast_to(np.array(v, np.float64).T, x.shape)[seen] for v in (ray.o, ray.d)
            )
            values = [self._shade(o, d, c[seen], n[seen]) for c, n in moved]
            change = (values[0] - values[1]) / (2 * step) * area[seen, None]
            pixel = at[seen].astype(np.int64) @ [1, width]
            np.add.at(image, pixel, change)
        return image.reshape(height, width, 5)

    def _shade(self, o: np.ndarray, d: np.ndarray, p: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Normal, mask and depth (R, 5) where rays meet the planes of triangles."""
        e1, e2, s = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], o - p[:, 0]
        h, k = np.cross(d, e2), np.cross(s, e1)
        det = (e1 * h).sum(1)
        b1, b2, t = (s * h).sum(1) / det, (d * k).sum(1) / det, (e2 * k).sum(1) / det
        b = np.stack([1 - b1 - b2, b1, b2], axis=1)
        normal = np.einsum("rk,rkc->rc", b, n)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        depth = self.lens.depth(o + t[:, None] * d)
        return np.column_stack([normal, np.ones(len(t)), depth])

    def _corners(self, step: float) -> np.ndarray:
        """(F, 3, 3) of all meshes."""
        return joined_vertices(self.meshes, step)[joined_faces(self.meshes)]

    def _corner_normals(self, step: float) -> np.ndarray:
        """Unit shading normals at corners, camera space (OpenCV axes), (F, 3, 3) of all meshes."""
        return corner_normals(self.meshes, step) @ self.lens.rotation

    def _depth(self, x: mi.Point3f) -> mi.Float:
        axis, origin = mi.Vector3f(self.lens.axis), mi.Vector3f(self.lens.place)
        return dr.dot(x - origin, axis)

    def _ray(self, q: mi.Point2f) -> mi.Ray3f:
        width, height = self.size
        at = mi.Point2f(q.x / width, q.y / height)
        return self.sensor.sample_ray(0, 0, at, mi.Point2f(0.5))[0]

    def _pixels(self, step: float) -> mi.UInt32:
        """Those of the rectangle in which something moves."""
        low, high = window(self.meshes, self.lens, step)
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
        return mi.UInt32((y * self.lens.width + x).ravel().astype(np.uint32))

    def _lattice(self, pixel: mi.UInt32, k: int, rays: int) -> mi.Point2f:
        """Place of ray ``k`` in each pixel."""
        width, _ = self.size
        k, step = dr.opaque(mi.Float, k), dr.opaque(mi.Float, 1 / rays)
        x = (k + 0.5) * step + mi.sample_tea_float32(pixel, 0)
        y = k * GOLDEN + mi.sample_tea_float32(pixel, 1)
        row = pixel // width
        return mi.Point2f(pixel - row * width + x - dr.floor(x), row + y - dr.floor(y))

    def _unfold(self, values: np.ndarray, pixel: np.ndarray) -> np.ndarray:
        width, height = self.size
        image = np.zeros((width * height, 5))
        image[pixel] = values
        return image.reshape(height, width, 5)


def _scene(meshes: Sequence[MovingMesh], step: float) -> tuple[mi.Scene, list[tuple[mi.Mesh, int]]]:
    """The meshes after a step, and for each the number of its first face."""
    shapes, first = [], 0
    for k, part in enumerate(meshes):
        mesh = mi.Mesh(f"m{k}", len(part.vertices), len(part.faces))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(part.at(step).ravel().astype(np.float32))
        parameters["faces"] = mi.UInt32(part.faces.ravel().astype(np.uint32))
        parameters.update()
        shapes.append((mesh, first))
        first += len(part.faces)
    scene = {f"m{k}": mesh for k, (mesh, _) in enumerate(shapes)}
    return mi.load_dict({"type": "scene", **scene}), shapes


def _meet(
    scene: mi.Scene, shapes: list[tuple[mi.Mesh, int]], ray: mi.Ray3f
) -> tuple[mi.UInt32, mi.Point2f, mi.Float, mi.Bool]:
    """Face, its coordinates, the ray's parameter, and whether there is a hit."""
    found = scene.ray_intersect_preliminary(ray, coherent=False)
    hit = found.is_valid()
    face = mi.UInt32(found.prim_index)
    for mesh, first in shapes:
        face += dr.select(found.shape == mi.ShapePtr(mesh), mi.UInt32(first), 0)
    return dr.select(hit, face, 0), found.prim_uv, found.t, hit
