"""Which points of a surface a camera sees.

A point is seen where its surface faces the camera, ``n · (eye - x) > 0``, and where the straight
line to the camera meets no triangle. The line starts a little off the surface, so that the
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


def seen_vertices(vertices: Tensor, faces: Tensor, camera: Camera) -> Tensor:
    """Which vertices a camera sees, wherever the picture ends, (V,) bool.

    Args:
        vertices: (V, 3) world, metres.
        faces: (F, 3) integers, counter-clockwise seen from outside.
        camera: a pinhole camera.
    """
    load_plugins()
    import mitsuba as mi

    vertices = vertices.detach().float()
    normals = vertex_normals(vertices, faces)
    start = vertices + OFF * normals
    toward = torch.from_numpy(camera.position.astype(np.float32)) - start
    distance = toward.norm(dim=1, keepdim=True)
    facing = (normals * toward).sum(1) > 0
    columns = lambda x: [mi.Float(column.contiguous().numpy()) for column in x.unbind(1)]
    reach = mi.Float((0.999 * distance[:, 0]).numpy())
    ray = mi.Ray3f(mi.Point3f(*columns(start)), mi.Vector3f(*columns(toward / distance)))
    ray.maxt = reach
    hidden = scene_of(faces, vertices).ray_test(ray)
    return facing & ~torch.from_numpy(np.array(hidden, dtype=bool))
