"""Noise of normals: smooth, of unit length, facing the camera, and biased where that is asked."""

import numpy as np
from gva_mi.data.synthetic.noise.errors import normal_error

from gva_mi.data.normals import NormalMaps, to_icon
from gva_mi.data.synthetic.noise.normals import NormalNoise, noisy_normals

USUAL = NormalNoise()
STILL = NormalNoise(blur=0.0, tilt=0.0)


def test_level_zero_is_exact(disc, rng):
    assert noisy_normals(disc[1], disc[0], USUAL, 0.0, rng) is disc[1]


def test_normals_stay_unit_face_the_camera_and_fill_the_mask(disc, rng):
    mask, normals = disc
    wider = (np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 26).astype(np.float32)
    noisy = noisy_normals(normals, wider, USUAL, 1.0, rng)
    length = np.linalg.norm(noisy, axis=-1)
    assert np.allclose(length[wider > 0.5], 1, atol=1e-5) and (length[wider <= 0.5] == 0).all()
    assert (noisy[..., 2] <= 0).all()
    assert 2 < normal_error(noisy, normals) < 20


def test_errors_of_normals_vary_slowly(rng):
    flat = np.zeros((128, 128, 3), np.float32)
    flat[..., 2] = -1
    full = np.ones((128, 128), np.float32)
    error = noisy_normals(flat, full, USUAL, 1.0, rng)[..., :2]
    size = np.sqrt((error**2).mean())
    step = np.sqrt((np.diff(error, axis=1) ** 2).mean())
    assert 0.05 < size < 0.3 and step < 0.25 * size  # a tilt that lasts over many pixels


def test_normals_are_blurred_like_a_networks(rng):
    ridge = np.zeros((64, 512, 3), np.float32)
    ridge[:, :256], ridge[:, 256:] = (-0.8, 0, -0.6), (0.8, 0, -0.6)
    blurred = noisy_normals(ridge, np.ones((64, 512), np.float32), USUAL, 1.0, rng)
    row = blurred[30, 246:266, 0]
    assert np.diff(row).max() < 0.4 * 1.6  # of the true step, which was between two pixels
    assert row[-1] - row[0] > 1.2


def test_errors_are_drawn_as_they_always_were(disc, rng):
    noisy = noisy_normals(disc[1], disc[0], USUAL, 1.0, rng)
    assert np.allclose(noisy[20, 20], (-0.590828, -0.530492, -0.607866), rtol=0, atol=2e-6)


def test_normals_under_an_empty_mask_stay_empty(rng):
    empty = np.zeros((16, 16), np.float32)
    assert not noisy_normals(np.zeros((16, 16, 3), np.float32), empty, USUAL, 1.0, rng).any()


def test_flat_normals_turn_toward_the_camera_everywhere(disc, rng):
    mask, normals = disc
    plain = noisy_normals(normals, mask, STILL, 1.0, rng)
    flat = noisy_normals(normals, mask, NormalNoise(blur=0.0, tilt=0.0, flat=0.3), 1.0, rng)
    inner = np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 20
    across = lambda n: np.hypot(n[..., 0], n[..., 1])[inner] / -n[..., 2][inner]
    assert np.allclose(across(flat), 0.7 * across(plain), atol=1e-4)


def test_a_turn_is_the_same_everywhere(disc, rng):
    mask, normals = disc
    plain = noisy_normals(normals, mask, STILL, 1.0, rng)
    noise = NormalNoise(blur=0.0, tilt=0.0, turn=(0.0, 0.1, 0.0))
    turned = noisy_normals(normals, mask, noise, 1.0, rng)
    inner = np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 16
    angle = lambda n: np.arctan2(n[..., 0], -n[..., 2])[inner]
    assert np.allclose(angle(turned) - angle(plain), -0.1, atol=1e-4)


def test_icons_convention_is_read_back_as_what_was_written(disc, camera, tmp_path):
    _, normals = disc
    (tmp_path / "normals").mkdir()
    np.save(tmp_path / "normals/000000.npy", to_icon(normals, camera).astype(np.float32))
    read = NormalMaps(tmp_path / "normals", "icon", None).read(0, camera)
    assert np.abs(read - normals).max() < 1e-6
