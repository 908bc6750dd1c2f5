"""Vertices that are visible from given places.

A vertex x is visible from a place y if its surface faces it, ``n · (y - x) > 0``, and the straight
line to it meets no triangle. The line starts a little off the surface, so that the triangles around
the point do not hide it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gva_mi.mesh.mesh_scene import load_plugins, scene_of
from gva_mi.mesh.surface import vertex_normals

OFF = 0.002  # metres off the surface


def seen_vertices(vertices: Tensor, faces: Tensor, viewpoints: np.ndarray) -> Tensor:
    """Return which vertices are visible from each of E viewpoints (E, 3), (E, V) bool.

    Faces are counter-clockwise seen from outside; the edges of pictures are ignored.
    """
    load_plugins()
    import mitsuba as mi

    vertices = vertices.detach().float()
    normals = vertex_normals(vertices, faces)
    start, scene = vertices + OFF * normals, scene_of(faces, vertices)
    columns = lambda x: np.ascontiguousarray(x.T.numpy(), np.float32)
    found = []
    for viewpoint in torch.from_numpy(np.asarray(viewpoints, dtype=np.float32)):
        toward = viewpoint - start
        distance = toward.norm(dim=1, keepdim=True)
        ray = mi.Ray3f(mi.Point3f(columns(start)), mi.Vector3f(columns(toward / distance)))
        ray.maxt = mi.Float((0.999 * distance[:, 0]).numpy())
        hidden = torch.from_numpy(np.array(scene.ray_test(ray), dtype=bool))
        found.append(((normals * toward).sum(1) > 0) & ~hidden)
    return torch.stack(found)
