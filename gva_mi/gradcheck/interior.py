"""Reference for the interior part of an image's derivative: every point stays on its triangle.

``Σ_faces ∫ dI/dε |∂q/∂b| db`` over the points seen, ``b`` barycentric, ``dI/dε`` by central
differences in float64. On the image the integrand grows without bound toward contours, where
surfaces are seen flat. Points spread over the triangles see no such peak, because a triangle seen
flat covers little of the image.

Visibility is Mitsuba's, by rays; nothing is shared with ``mesh_normals``. Images are those of a
box filter, (H, W, 5): normal in camera space, mask, depth.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.gradcheck.moving_mesh import MovingMesh, PinholeLens
from gva_mi.mesh.mesh_scene import load_plugins

if TYPE_CHECKING:
    import mitsuba as mi

GOLDEN = 0.6180339887498949
HIDDEN = 1e-4  # a point is hidden by what is closer by this share of its distance


def interior(mesh: MovingMesh, lens: PinholeLens, step: float, points: int) -> np.ndarray:
    """Return the derivative of the image where nothing appears or disappears, (H, W, 5).

    Args:
        mesh: with its motion.
        lens: of the camera.
        step: ε of the differences.
        points: on each face.
    """
    load_plugins()
    scene = mesh.scene()
    p = mesh.vertices[mesh.faces]  # (F, 3, 3)
    moved = [
        (mesh.at(s)[mesh.faces], mesh.corner_normals(s) @ lens.rotation) for s in (step, -step)
    ]
    flat = p.reshape(-1, 3)
    q, scale = lens.project(flat).reshape(-1, 3, 2), lens.scale(flat).reshape(-1, 3)
    e1, e2 = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    doubled = np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
    image = np.zeros((math.prod(lens.size), 5))
    for k in range(points):
        b1, b2 = (k + 0.5) / points, (0.5 + k * GOLDEN) % 1
        b1, b2 = (b1, b2) if b1 + b2 < 1 else (1 - b1, 1 - b2)
        x = np.einsum("k,fkc->fc", np.array([1 - b1 - b2, b1, b2]), p)
        at = lens.project(x)
        o, d = lens.rays(at)
        seen = _reached(scene, o, d, x) & ((at >= 0) & (at < lens.size)).all(1)
        area = doubled * scale.prod(1) / lens.scale(x) ** 3 / (2 * points)
        ahead, behind = (_shade(lens, o[seen], d[seen], c[seen], n[seen]) for c, n in moved)
        change = (ahead - behind) / (2 * step) * area[seen, None]
        np.add.at(image, at[seen].astype(np.int64) @ [1, lens.size[0]], change)
    return image.reshape(*lens.size[::-1], 5)


def _reached(scene: mi.Scene, o: np.ndarray, d: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Whether rays reach the points x (F, 3), one on each face in turn, (F,) bool."""
    import mitsuba as mi

    o, d = o.T.astype(np.float32), d.T.astype(np.float32)
    found = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)), coherent=False)
    own = np.array(found.is_valid()) & (np.array(found.prim_index) == np.arange(len(x)))
    return own | (np.array(found.t) > np.linalg.norm(x - o.T, axis=1) * (1 - HIDDEN))


def _shade(
    lens: PinholeLens, o: np.ndarray, d: np.ndarray, p: np.ndarray, n: np.ndarray
) -> np.ndarray:
    """Normal, mask and depth (R, 5) where rays meet the planes of triangles."""
    e1, e2, s = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], o - p[:, 0]
    h, k = np.cross(d, e2), np.cross(s, e1)
    det = (e1 * h).sum(1)
    b1, b2, t = (s * h).sum(1) / det, (d * k).sum(1) / det, (e2 * k).sum(1) / det
    normal = np.einsum("rk,rkc->rc", np.stack([1 - b1 - b2, b1, b2], axis=1), n)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.column_stack([normal, np.ones(len(t)), lens.depth(o + t[:, None] * d)])
