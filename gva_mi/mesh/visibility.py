"""What rays meet of a mesh: normals where they enter and leave it, and vertices they reach.

1. ``front(d) = n`` at the first point of the mesh on the ray ``c + s d``, ``s > 0``,
2. ``back(d) = n`` at its last point: the first one that is met from far away, along ``-d``,

with the smooth normals of the mesh, outward, in the camera's axes. Networks such as ICON's see both
of a posed body. A vertex x is visible from a place y if its surface faces it, ``n · (y - x) > 0``,
and the straight line to it meets no triangle. The line starts a little off the surface, so that the
triangles around the point do not hide it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gva_mi.mesh.mesh_scene import load_plugins, scene_of
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat import Camera

OFF = 0.002  # metres off the surface


def _rays(origin: np.ndarray, along: np.ndarray) -> object:
    """Return Mitsuba's rays (R,) from points (R, 3) along directions (R, 3)."""
    import mitsuba as mi

    columns = lambda x: (mi.Float(np.ascontiguousarray(column, np.float32)) for column in x.T)
    return mi.Ray3f(mi.Point3f(*columns(origin)), mi.Vector3f(*columns(along)))


def normals_of_both_sides(
    vertices: Tensor, faces: Tensor, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``front`` and ``back`` at the centres of the pixels.

    Args:
        vertices: (V, 3) float32, world, metres.
        faces: (F, 3) integers, counter-clockwise seen from outside.
        camera: a pinhole.

    Returns:
        (H, W, 3) float32 each, camera space (x right, y down, z forward), zero beside the mesh.
    """
    load_plugins()
    x, R = vertices.detach().float(), camera.T_camera_world[:3, :3]
    column = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    row = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    d = np.stack([*np.meshgrid(column, row), np.ones((camera.height, camera.width))], axis=-1)
    d = (d / np.linalg.norm(d, axis=-1, keepdims=True) @ R).reshape(-1, 3)
    eye = np.broadcast_to(camera.position, d.shape)
    far = eye + d * (1 + np.linalg.norm(x.numpy() - camera.position, axis=1).max())
    scene = scene_of(faces, x)
    normals = vertex_normals(x, faces).numpy() @ R.T.astype(np.float32)
    corners = normals[faces.numpy()]  # (F, 3, 3)

    def first(origin: np.ndarray, along: np.ndarray) -> np.ndarray:
        found = scene.ray_intersect_preliminary(_rays(origin, along), coherent=True)
        hit = np.array(found.is_valid())
        of = np.where(hit, np.array(found.prim_index), 0)
        u, v = np.where(hit, np.array(found.prim_uv), 0)[:, :, None]
        n = (1 - u - v) * corners[of, 0] + u * corners[of, 1] + v * corners[of, 2]
        n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12) * hit[:, None]
        return n.reshape(camera.height, camera.width, 3).astype(np.float32)

    return first(eye, d), first(far, -d)


def seen_vertices(vertices: Tensor, faces: Tensor, viewpoints: np.ndarray) -> Tensor:
    """Return which vertices are visible from each of E viewpoints (E, 3), (E, V) bool.

    Faces are counter-clockwise seen from outside; the edges of pictures are ignored.
    """
    load_plugins()
    import mitsuba as mi

    vertices = vertices.detach().float()
    normals = vertex_normals(vertices, faces)
    start, scene = vertices + OFF * normals, scene_of(faces, vertices)
    found = []
    for viewpoint in torch.from_numpy(np.asarray(viewpoints, dtype=np.float32)):
        toward = viewpoint - start
        distance = toward.norm(dim=1, keepdim=True)
        ray = _rays(start.numpy(), (toward / distance).numpy())
        ray.maxt = mi.Float((0.999 * distance[:, 0]).numpy())
        hidden = torch.from_numpy(np.array(scene.ray_test(ray), dtype=bool))
        found.append(((normals * toward).sum(1) > 0) & ~hidden)
    return torch.stack(found)
