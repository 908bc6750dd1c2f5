"""Background, blur and sensor noise, applied in this order to sRGB-encoded pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

READ, SHOT = 0.006, 0.02  # standard deviation at level 1: constant, and growing with the light


@dataclass(frozen=True)
class CameraEffects:
    """What the camera of a video adds to clean pictures."""

    blur: float  # px, standard deviation
    sensor: float  # level of the sensor noise; 0 is none
    background: np.ndarray | None  # (H, W, 3); None is white

    def apply(self, color: np.ndarray, mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return a clean picture (H, W, 3) on white, with its mask (H, W), as this camera sees it.

        ``rng`` draws the sensor noise.
        """
        from scipy.ndimage import gaussian_filter

        if self.background is not None:
            color = color + (1 - mask[..., None]) * (self.background - 1)
        if self.blur > 0:
            color = gaussian_filter(color, (self.blur, self.blur, 0))
        if self.sensor > 0:
            sigma = self.sensor * np.sqrt(READ**2 + SHOT**2 * np.clip(color, 0, 1))
            color = color + sigma * rng.normal(size=color.shape)
        return np.clip(color, 0, 1).astype(np.float32)


def room_background(size: int, rng: np.random.Generator) -> np.ndarray:
    """Draw a room out of focus, (size, size, 3) in [0, 1]: a wall, a floor and things in it."""
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
