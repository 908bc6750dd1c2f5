"""Normals of a sphere where rays enter and leave it, against the quadratic equation."""

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba")


def test_rays_enter_and_leave_a_sphere():
    """A point x of the unit sphere has the normal x; a ray meets it where |c + s d| is 1."""
    import trimesh

    from gva_mi.mesh.both_sides import normals_of_both_sides
    from gva_mi.splat import Camera, look_at

    sphere = trimesh.creation.icosphere(subdivisions=4)
    vertices = torch.from_numpy(np.asarray(sphere.vertices, np.float32))
    faces = torch.from_numpy(np.asarray(sphere.faces, np.int64))
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
