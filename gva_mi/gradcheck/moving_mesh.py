"""A moving mesh and a lens in float64, for the reference derivatives of ``mesh_normals``.

Nothing here or in ``scanlines.py`` and ``interior.py`` is shared with the plugin they check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.mesh.mesh_scene import scene_of
from gva_mi.splat import Camera

if TYPE_CHECKING:
    import mitsuba as mi

STILL = 1e-6  # of the greatest speed: a vertex slower than that counts as still


@dataclass(frozen=True)
class PinholeLens:
    """Pinhole projection of world points; pixel centres lie at +0.5."""

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

    def scale(self, x: np.ndarray) -> np.ndarray:
        """Return the divisors (N,) of the pixel positions."""
        return self.depth(x)

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
    """A mesh and a direction in which its vertices move."""

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
        moves = speed > STILL * speed.max()
        # Their neighbours' shading normals move with them.
        moves |= np.isin(np.arange(len(moves)), self.faces[moves[self.faces].any(1)])
        q = lens.project(np.concatenate([self.at(s)[moves] for s in (step, -step)]))
        low, high = np.floor(q.min(0)) - 1, np.ceil(q.max(0)) + 1
        return tuple(np.clip(end, 0, lens.size).astype(int) for end in (low, high))
