"""Stage 1 of a film: known poses come back from their landmarks, whatever is missing."""

import numpy as np
import pytest
import torch

from gva_mi.pose.film.solver import solve_film

LIMBS = slice(1, 22)  # joints of the body without the root


def solved(film, body, landmarks=None, **options):
    """Solve a film whose camera and height are known."""
    camera = film.camera
    known = {"fps": 10.0, "height": film.height, "focal": camera.fx} | options
    return solve_film(landmarks or film.landmarks, body, (camera.width, camera.height), **known)


def errors(found, film, body):
    """Return distances (T, 55) of joints from the true ones, in both cameras' axes, metres."""
    in_camera = []
    for pose, shape, camera in (
        (found.pose, found.shape, found.camera),
        (film.pose, film.shape, film.camera),
    ):
        T = torch.from_numpy(np.array(camera.T_camera_world))
        in_camera.append(body(pose, shape).joints.double() @ T[:3, :3].T + T[:3, 3])
    return (in_camera[0] - in_camera[1]).norm(dim=2)


@pytest.fixture(scope="module")
def found(known_film, built_in_body):
    return solved(known_film, built_in_body)


def test_known_poses_come_back(found, known_film, built_in_body):
    assert errors(found, known_film, built_in_body)[:, LIMBS].mean() < 0.06


def test_the_world_is_upright_with_the_floor_at_zero(found, built_in_body):
    assert found.tilt == pytest.approx(20, abs=2.5)
    lowest = built_in_body(found.pose, found.shape).vertices[..., 1].amin(1)
    assert lowest.abs().max() < 0.02
