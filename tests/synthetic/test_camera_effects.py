"""Background, blur and noise of a camera."""

import numpy as np

from gva_mi.synthetic.camera_effects import CameraEffects, room_background


def random():
    return np.random.default_rng(0)


def apply(color, blur=0.0, sensor=0.0):
    return CameraEffects(blur, sensor, None).apply(color, np.ones(color.shape[:2]), random())


def test_without_effects_a_picture_stays_the_same():
    color = random().random((8, 8, 3)).astype(np.float32)
    assert np.array_equal(apply(color), color)


def test_noise_grows_with_the_light_and_the_level():
    dark, bright = (np.full((64, 64, 3), v, np.float32) for v in (0.1, 0.7))
    assert apply(dark, sensor=1.0).std() < apply(bright, sensor=1.0).std()
    assert apply(bright, sensor=1.0).std() < apply(bright, sensor=2.0).std() < 0.05


def test_blur_keeps_the_mean():
    color = random().random((32, 32, 3)).astype(np.float32)
    blurred = apply(color, blur=1.5)
    assert abs(blurred.mean() - color.mean()) < 0.01 and blurred.std() < 0.5 * color.std()


def test_a_background_shows_where_the_mask_is_open():
    background = room_background(48, random())
    assert background.shape == (48, 48, 3) and 0 <= background.min() and background.max() <= 1
    assert background.std() > 0.03
    mask = np.zeros((48, 48), np.float32)
    mask[10:30, 10:30] = 1
    mask[30] = 0.5
    person = np.full((48, 48, 3), 0.2, np.float32)
    on_white = mask[..., None] * person + (1 - mask[..., None])
    shown = CameraEffects(0.0, 0.0, background).apply(on_white, mask, random())
    expected = mask[..., None] * person + (1 - mask[..., None]) * background
    assert np.allclose(shown, expected, atol=1e-6)
