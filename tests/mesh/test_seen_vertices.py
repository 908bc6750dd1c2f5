"""What rays meet of balls: vertices that are not hidden."""

import numpy as np
import torch
import trimesh

from gva_mi.mesh.mesh_scene import seen_vertices

EYE = np.array([[0.0, 0.0, 5.0]])


def ball(centre, radius, finer=3):
    mesh = trimesh.creation.icosphere(subdivisions=finer, radius=radius)
    vertices = torch.from_numpy(mesh.vertices + np.array(centre)).float()
    return vertices, torch.from_numpy(np.array(mesh.faces))


def test_the_near_cap_of_a_ball_is_seen():
    """Up to the horizon, where a line from the viewpoint touches the ball: z = r² / distance."""
    vertices, faces = ball((0, 0, 0), 1.0)
    near, far = seen_vertices(vertices, faces, np.concatenate([EYE, -EYE]))
    for seen, side in ((near, 1), (far, -1)):
        z = side * vertices[:, 2]
        assert seen[z > 0.2 + 0.05].all() and not seen[z < 0.2 - 0.05].any()


def test_what_stands_behind_is_hidden_and_what_stands_beside_is_not():
    front, faces = ball((0, 0, 1), 0.8)
    for centre, visible in (((0, 0, -1), False), ((2, 0, -1), True)):
        other, more = ball(centre, 0.4)
        vertices = torch.cat([front, other])
        seen = seen_vertices(vertices, torch.cat([faces, more + len(front)]), EYE)[0]
        assert bool(seen[len(front) :].any()) is visible
        assert seen[: len(front)].any()
