"""A phone sees the whole person, from eye height, looking down a little."""

import numpy as np
import pytest

from gva_mi.synthetic.cameras import HEIGHT, TILT, PhoneCamera, held_by_hand


def person(rng, wander=0.0):
    """Corners of a person who may walk about, (T, n, 3)."""
    at = rng.uniform(-wander, wander, (6, 1, 3)) * [1, 0, 1]
    return np.array([[x, y, z] for x in (-0.5, 0.5) for y in (0, 1.75) for z in (-0.2, 0.2)]) + at


@pytest.mark.parametrize("around", [False, True])
@pytest.mark.parametrize("wander", [0.0, 0.8])
def test_the_whole_person_is_in_view(around, wander):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points = person(rng, wander)
        phone = PhoneCamera.draw(rng, points, 512, around)
        assert HEIGHT[0] <= phone.height <= HEIGHT[1] and 0 <= phone.tilt <= TILT
        for azimuth in (0.0, 1.57, 3.0) if around else (0.0,):
            camera = phone.camera(azimuth)
            pixels = camera.project(points)
            assert (pixels > 8).all() and (pixels < 504).all()
            down = np.degrees(np.arcsin(-camera.T_camera_world[2, 1]))
            assert down == pytest.approx(np.degrees(phone.tilt), abs=1e-6)
        tall = np.ptp(phone.camera().project(points)[..., 1], axis=1)
        assert wander or tall.max() > 280


def test_a_hand_moves_the_phone_a_little_and_smoothly():
    shaken = held_by_hand(np.random.default_rng(0))
    phone = PhoneCamera(np.zeros(3), 1.5, 3.0, 0.1, 1.3, 512)
    t = np.arange(0, 6, 1 / 30)
    cameras = [phone.camera(0.0, *shaken(x)) for x in t]
    eyes = np.stack([camera.position for camera in cameras])
    assert 0.002 < np.abs(eyes - eyes.mean(0)).max() < 0.1
    pixels = np.stack([camera.project(np.array([0.0, 0.9, 0.0])) for camera in cameras])
    assert 2 < np.ptp(pixels, axis=0).max() < 60
    assert np.abs(np.diff(pixels, axis=0)).max() < 5
