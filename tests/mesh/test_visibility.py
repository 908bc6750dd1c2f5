"""What rays meet of balls: normals on both sides, and vertices that are not hidden."""

import numpy as np
import torch
import trimesh

from gva_mi.mesh.visibility import normals_of_both_sides, seen_vertices
from gva_mi.splat import Camera, look_at

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


def test_rays_enter_and_leave_a_sphere():
    """A point x of the unit sphere has the normal x; a ray meets it where |c + s d| is 1."""
    vertices, faces = ball((0, 0, 0), 1.0, finer=4)
    camera = Camera(50, 40, 19, 11, look_at((1.0, 2.0, 4.0), (0.2, -0.1, 0)), 36, 24)
    front, back = normals_of_both_sides(vertices, faces, camera)
    v, u = np.mgrid[:24, :36] + 0.5
    d = np.stack([(u - 19) / 50, (v - 11) / 40, np.ones_like(u)], axis=-1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    c = -camera.T_camera_world[:3, 3]  # of the camera as seen from the sphere's centre
    along = d @ c
    square = along**2 - c @ c + 1
    inside, outside = square > 0.02, square < -0.02  # the outline of triangles is left out
    assert inside.sum() > 200 and outside.sum() > 100
    for found, sign in ((front, -1), (back, 1)):
        expected = c + (-along + sign * np.sqrt(square.clip(0)))[..., None] * d
        assert np.abs(found - expected)[inside].max() < 0.03
        assert not found[outside].any()
