"""What a camera adds to a picture."""

import numpy as np

from gva_mi.data.synthetic import camera_effects


def random():
    return np.random.default_rng(0)


def test_without_blur_and_noise_a_picture_stays_itself():
    color = random().random((8, 8, 3)).astype(np.float32)
    assert np.array_equal(camera_effects.blur_and_noise(color, 0.0, 0.0, random()), color)


def test_noise_grows_with_the_light_and_with_the_level():
    dark, bright = (np.full((64, 64, 3), v, np.float32) for v in (0.1, 0.7))
    spread = lambda color, level: camera_effects.blur_and_noise(color, 0.0, level, random()).std()
    assert spread(dark, 1.0) < spread(bright, 1.0) < spread(bright, 2.0) < 0.05


def test_blur_keeps_the_mean():
    color = random().random((32, 32, 3)).astype(np.float32)
    blurred = camera_effects.blur_and_noise(color, 1.5, 0.0, random())
    assert abs(blurred.mean() - color.mean()) < 0.01 and blurred.std() < 0.5 * color.std()


def test_a_background_shows_where_the_mask_is_open():
    background = camera_effects.room_background(48, random())
    assert background.shape == (48, 48, 3) and 0 <= background.min() and background.max() <= 1
    assert background.std() > 0.03
    mask = np.zeros((48, 48), np.float32)
    mask[10:30, 10:30] = 1
    mask[30] = 0.5
    person = np.full((48, 48, 3), 0.2, np.float32)
    on_white = mask[..., None] * person + (1 - mask[..., None])
    shown = camera_effects.over_background(on_white, mask, background)
    expected = mask[..., None] * person + (1 - mask[..., None]) * background
    assert np.allclose(shown, expected, atol=1e-6)
