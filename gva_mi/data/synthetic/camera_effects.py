"""What a camera adds to a clean picture: a background, blur, and the noise of its sensor.

Applied in this order to the stored, sRGB-encoded picture; masks and truth stay as they are.
"""

from __future__ import annotations

import numpy as np

# Standard deviation of a pixel's noise at level 1: read noise, the same everywhere, and shot noise,
# which grows with the light.
READ, SHOT = 0.006, 0.02


def room_background(size: int, rng: np.random.Generator) -> np.ndarray:
    """A room out of focus, (size, size, 3) in [0, 1]: a wall, a floor, and things in it."""
    from scipy.ndimage import gaussian_filter

    y, x = np.mgrid[:size, :size] / size
    wall, floor = rng.uniform(0.45, 0.8, 3), rng.uniform(0.25, 0.55, 3)
    horizon = rng.uniform(0.72, 0.82)
    light = 1 - 0.35 * np.hypot(x - rng.uniform(0.2, 0.8), y - 0.2)
    image = np.where((y < horizon)[..., None], wall, floor) * light[..., None]
    for _ in range(9):
        left, width = rng.uniform(-0.1, 1.0), rng.uniform(0.04, 0.25)
        bottom, height = horizon + rng.uniform(-0.45, 0.08), rng.uniform(0.08, 0.45)
        inside = (np.abs(x - left) < width / 2) & (y < bottom) & (y > bottom - height)
        shade = 0.8 + 0.4 * (y - bottom + height) / height
        image = np.where(inside[..., None], rng.uniform(0.08, 0.9, 3) * shade[..., None], image)
    grain = gaussian_filter(rng.normal(size=(size, size)), size / 90)
    image = image * (1 + 0.06 * grain / grain.std())[..., None]
    return np.clip(gaussian_filter(image, (size / 110, size / 110, 0)), 0, 1).astype(np.float32)


def over_background(color: np.ndarray, mask: np.ndarray, background: np.ndarray) -> np.ndarray:
    """A picture on white (H, W, 3) with its mask (H, W), put before another background."""
    return color + (1 - mask[..., None]) * (background - 1)


def blur_and_noise(
    color: np.ndarray, blur: float, level: float, rng: np.random.Generator
) -> np.ndarray:
    """The picture (H, W, 3) as lens and sensor give it.

    Args:
        color: in [0, 1].
        blur: standard deviation in pixels.
        level: of the noise; 0 is none.
        rng: for the noise.
    """
    from scipy.ndimage import gaussian_filter

    if blur > 0:
        color = gaussian_filter(color, (blur, blur, 0))
    if level > 0:
        sigma = level * np.sqrt(READ**2 + SHOT**2 * np.clip(color, 0, 1))
        color = color + sigma * rng.normal(size=color.shape)
    return np.clip(color, 0, 1).astype(np.float32)
