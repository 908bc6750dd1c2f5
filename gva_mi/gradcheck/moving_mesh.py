"""A moving mesh in float64, and the reference for the interior part of its image's derivative.

In the interior part every point stays on its triangle: ``Σ_faces ∫ dI/dε |∂q/∂b| db`` over the
visible points, ``b`` barycentric, ``dI/dε`` by central differences in float64. On the image the
integrand grows without bound toward contours, at grazing angles. An integral over the triangles has
no such peak, because a triangle at a grazing angle covers little of the image.

Mitsuba's rays find the visible points. Nothing here or in ``scanlines.py`` is shared with the
plugin that is checked. Images have a box filter and five channels, (H, W, 5): normal in camera
space, mask, depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.mesh.mesh_scene import load_plugins, scene_of
from gva_mi.splat import Camera

if TYPE_CHECKING:
    import mitsuba as mi


# Share of the greatest speed below which a vertex counts as still. Chosen: differences of float64
# leave smaller speeds by rounding.
STILL_SPEED = 1e-6


@dataclass(frozen=True)
class PinholeLens:
    """Pinhole projection of world points; pixel centres lie at +0.5.

    Example:
        >>> lens = PinholeLens(Camera(8.0, 8.0, 8.0, 8.0, np.eye(4), 16, 16))
        >>> point = np.array([[1.0, 0.0, 4.0]])
        >>> lens.project(point), lens.depth(point)
        (array([[10., 8.]]), array([4.]))
    """

    camera: Camera

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.camera.width, self.camera.height

    @property
    def rotation(self) -> np.ndarray:
        """Return the (3, 3) matrix whose columns are right, down and forward in the world."""
        return self.camera.T_camera_world[:3, :3].T

    def project(self, x: np.ndarray) -> np.ndarray:
        """Return the pixel positions (N, 2) of world points (N, 3)."""
        return self.camera.project(x)

    def depth(self, x: np.ndarray) -> np.ndarray:
        """Return the distances (N,) of points from the camera's plane."""
        return (x - self.camera.position) @ self.rotation[:, 2]

    def nearness(self, x: np.ndarray) -> np.ndarray:
        """Return (N,) a measure that grows toward the camera, affine on the image of a plane."""
        return 1 / self.depth(x)

    def rays(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and unit directions (N, 3) of the rays through pixel positions (N, 2)."""
        d = np.column_stack([q, np.ones(len(q))]) @ np.linalg.inv(self.camera.K).T @ self.rotation.T
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        return np.broadcast_to(self.camera.position, d.shape), d


@dataclass(frozen=True)
class MovingMesh:
    """A mesh and a direction in which its vertices move.

    Example:
        >>> mesh = MovingMesh(np.eye(3), np.array([[0, 1, 2]]), np.ones((3, 3)))
        >>> mesh.at(0.5)[0]
        array([1.5, 0.5, 0.5])
        >>> mesh.corner_normals(0.5)[0, 0].round(2)  # a translation does not turn them
        array([0.58, 0.58, 0.58])
    """

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3)
    motion: np.ndarray  # (V, 3) dx

    def at(self, step: float) -> np.ndarray:
        """Return the vertices after a step, (V, 3)."""
        return self.vertices + step * self.motion

    def corner_normals(self, step: float) -> np.ndarray:
        """Return unit shading normals at corners after a step, world, (F, 3, 3)."""
        v, f = self.at(step), self.faces
        c = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        n = np.zeros_like(v)
        np.add.at(n, f.ravel(), np.repeat(c, 3, axis=0))
        corners = n[f]
        return corners / np.linalg.norm(corners, axis=2, keepdims=True)

    def scene(self) -> mi.Scene:
        """Return a scene of Mitsuba with this mesh."""
        vertices = torch.from_numpy(self.vertices.astype(np.float32))
        return scene_of(torch.from_numpy(self.faces), vertices)

    def window(self, lens: PinholeLens, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the rectangle of pixels in which something moves: first (2,) and end (2,), x y."""
        speed = np.linalg.norm(self.motion, axis=1)
        moves = speed > STILL_SPEED * speed.max()
        # Their neighbours' shading normals move with them.
        moves |= np.isin(np.arange(len(moves)), self.faces[moves[self.faces].any(1)])
        q = lens.project(np.concatenate([self.at(s)[moves] for s in (step, -step)]))
        low, high = np.floor(q.min(0)) - 1, np.ceil(q.max(0)) + 1
        return tuple(np.clip(end, 0, lens.size).astype(int) for end in (low, high))


GOLDEN_STEP = 0.6180339887498949  # 1 / golden ratio: the step of a Kronecker sequence
# Share of a point's distance by which an occluder must lie nearer than it. Chosen: above float32's
# rounding of Mitsuba's hits.
OCCLUDER_MARGIN = 1e-4


def interior(mesh: MovingMesh, lens: PinholeLens, step: float, points: int) -> np.ndarray:
    """Return the derivative of the image where nothing appears or disappears, (H, W, 5).

    Args:
        mesh: with its motion.
        lens: of the camera.
        step: ε of the differences.
        points: on each face.

    Example:
        >>> from gva_mi.splat import look_at
        >>> camera = Camera(16.0, 16.0, 8.0, 8.0, look_at((2, 2, 2), (0, 0, 0)), 16, 16)
        >>> mesh = MovingMesh(np.eye(3), np.array([[0, 1, 2]]), np.ones((3, 3)))
        >>> change = interior(mesh, PinholeLens(camera), step=1e-5, points=64)
        >>> area = np.sqrt(3) / 2 * (16 / (np.sqrt(12) - np.sqrt(1 / 3))) ** 2  # pixels
        >>> (change[..., 4].sum() / area).round(2)  # the mean depth shrinks by √3
        np.float64(-1.73)
    """
    load_plugins()
    scene = mesh.scene()
    p = mesh.vertices[mesh.faces]  # (F, 3, 3)
    corners = lambda s: (mesh.at(s)[mesh.faces], mesh.corner_normals(s) @ lens.rotation)
    moved = [corners(step), corners(-step)]
    flat = p.reshape(-1, 3)
    q, depth = lens.project(flat).reshape(-1, 3, 2), lens.depth(flat).reshape(-1, 3)
    e1, e2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    doubled = np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    image = np.zeros((math.prod(lens.size), 5))
    for k in range(points):
        b1, b2 = (k + 0.5) / points, (0.5 + k * GOLDEN_STEP) % 1
        b1, b2 = (b1, b2) if b1 + b2 < 1 else (1 - b1, 1 - b2)
        x = np.einsum("k,fkc->fc", np.array([1 - b1 - b2, b1, b2]), p)
        at = lens.project(x)
        o, d = lens.rays(at)
        seen = _reached(scene, o, d, x) & ((at >= 0) & (at < lens.size)).all(1)
        area = doubled * depth.prod(1) / lens.depth(x) ** 3 / (2 * points)
        ahead, behind = (_shade(lens, o[seen], d[seen], c[seen], n[seen]) for c, n in moved)
        change = (ahead - behind) / (2 * step) * area[seen, None]
        np.add.at(image, at[seen].astype(np.int64) @ [1, lens.size[0]], change)
    return image.reshape(*lens.size[::-1], 5)


def _reached(scene: mi.Scene, o: np.ndarray, d: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return whether rays reach the points x (F, 3), one on each face in turn, (F,) bool."""
    import mitsuba as mi

    o, d = o.T.astype(np.float32), d.T.astype(np.float32)
    found = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)), coherent=False)
    met = np.array(found.is_valid()) & (np.array(found.prim_index) == np.arange(len(x)))
    return met | (np.array(found.t) > np.linalg.norm(x - o.T, axis=1) * (1 - OCCLUDER_MARGIN))


def _shade(
    lens: PinholeLens, o: np.ndarray, d: np.ndarray, p: np.ndarray, n: np.ndarray
) -> np.ndarray:
    """Return normal, mask and depth (R, 5) where rays meet the planes of triangles."""
    e1, e2, s = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], o - p[:, 0]
    h, k = np.cross(d, e2), np.cross(s, e1)
    det = (e1 * h).sum(1)
    b1, b2, t = (s * h).sum(1) / det, (d * k).sum(1) / det, (e2 * k).sum(1) / det
    normal = np.einsum("rk,rkc->rc", np.stack([1 - b1 - b2, b1, b2], axis=1), n)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.column_stack([normal, np.ones(len(t)), lens.depth(o + t[:, None] * d)])
