"""Cameras see the whole person; a phone looks down a little, and its video has noise."""

from fractions import Fraction

import numpy as np
import pytest

from gva_mi.subject.video_file import VideoFile
from gva_mi.synthetic.pictures.cameras import (
    BITS_PER_PIXEL,
    MAX_TILT,
    PHONE_HEIGHTS,
    PhoneCamera,
    camera_around,
    write_phone_video,
)


def person(rng, wander=0.0):
    """Corners of a person who may walk about, (T, n, 3)."""
    at = rng.uniform(-wander, wander, (6, 1, 3)) * [1, 0, 1]
    return np.array([[x, y, z] for x in (-0.5, 0.5) for y in (0, 1.75) for z in (-0.2, 0.2)]) + at


@pytest.mark.parametrize("wander", [0.0, 0.8])
def test_a_phone_sees_the_whole_person(wander):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points = person(rng, wander)
        phone = PhoneCamera.draw(rng, points, 512)
        assert PHONE_HEIGHTS[0] <= phone.height <= PHONE_HEIGHTS[1] and 0 <= phone.tilt <= MAX_TILT
        camera = phone.camera()
        pixels = camera.project(points)
        assert (pixels > 8).all() and (pixels < 504).all()
        down = np.degrees(np.arcsin(-camera.T_camera_world[2, 1]))
        assert down == pytest.approx(np.degrees(phone.tilt), abs=1e-6)
        assert wander or np.ptp(pixels[..., 1], axis=1).max() > 280


@pytest.mark.parametrize("azimuth, elevation", [(0, 0.06), (-2.6, 0.4)])
def test_the_camera_sees_the_whole_surface(ball, azimuth, elevation):
    camera = camera_around(ball.vertices + [3.0, 1.0, -2.0], 64, azimuth, elevation)
    pixels = camera.project(ball.vertices + [3.0, 1.0, -2.0])
    assert (pixels > 0).all() and (pixels < 64).all()
    assert np.ptp(pixels, axis=0).max() > 40


def test_a_video_shows_the_pictures_with_noise_and_always_the_same(tmp_path):
    y, x = np.mgrid[:96, :64]
    pictures = [
        np.stack([2 * x + 3 * k, 2 * y, 250 - 2 * y], axis=-1).astype(np.uint8) for k in range(20)
    ]
    files = []
    for name in ("a.mp4", "b.mp4"):
        write_phone_video(tmp_path / name, pictures, Fraction(40, 3), np.random.default_rng(0))
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]
    assert len(files[0]) < 3 * BITS_PER_PIXEL / 8 * 96 * 64 * 20
    recording = VideoFile(tmp_path / "a.mp4")
    assert len(recording) == 20
    for seen, true in zip(recording, pictures, strict=True):
        off = seen.astype(int) - true
        assert np.abs(off.mean((0, 1))).max() < 3 and off.std() < 8
