"""How dark the shadows are that a person casts in a film.

A shadow multiplies the background by some s < 1 and leaves its hue. Under a sky or several lamps it
is faint: 1 - s is distributed exponentially, with a mean σ. The sun, or one lamp, casts deep ones,
of any s. With their share w of all shadows, the density of s is

1. ``k(s) = (1 - w) exp(-(1 - s) / σ) / σ + w / (1 - DARKEST)``,   ``s <= 1``

Above 1 it falls within BRIGHT. The film shows w where the person surely is not. Pixels there are
counted, high up and near the floor separately; of their shares in deep and in faint shadow,

2. ``w = deep / (deep + faint + FEW)``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.data.matting.plate import Plate

DARKEST, BRIGHTEST = 0.25, 1.15  # range of s
DEEP, FAINT = 0.75, 0.9  # s up to which a pixel counts as in a deep shadow, and in a faint one
FEW = 0.01  # share of pixels of both kinds below which films hardly tell
SAME_HUE = 3.0  # standard deviations of a background's colour that a shadowed one may be off
NOISE = 0.012  # smallest such deviation: edges of a shadow are blurred by compression
FEET = 0.92  # of the person's height, from the top: below, they touch the floor
SHADED, AT_FEET = 0.2, 0.5  # share of the background that is in shadow: anywhere, and there
MEAN, CONTACT = 0.1, 0.4  # σ: anywhere, and there
LOW = 0.8  # height from which on w is that near the floor
BRIGHT = 0.02  # mean of s - 1: nothing shines on the background but what lights it anyway


def shade(image: np.ndarray, plate: Plate) -> np.ndarray:
    """Return s (h, w) of the nearest point to each colour (h, w, 3) on the plate's line."""
    B, variance = plate.color, plate.spread**2
    along = np.einsum("ijk,ijk->ij", image, B) + variance
    return (along / (np.einsum("ijk,ijk->ij", B, B) + variance)).clip(DARKEST, BRIGHTEST)


@dataclass(frozen=True)
class Shadows:
    """Shares w of deep shadows: high up, and near the floor."""

    high: float = 0.0
    low: float = 0.0

    @staticmethod
    def of(counts: np.ndarray) -> Shadows:
        """Return eq. 2 of the sum (2, 3) of some :func:`counted`."""
        deep, faint = counts[:, 1:].T / np.maximum(counts[:, 0], 1)
        return Shadows(*(deep / (deep + faint + FEW)).tolist())

    def shaded(self, height: np.ndarray) -> np.ndarray:
        """Return the share (h, 1) of the background that is in shadow, of rows (h,) of heights."""
        return np.where(height > FEET, np.float32(AT_FEET), np.float32(SHADED))[:, None]

    def density(self, s: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return k (h, w), eq. 1, for rows of some heights (h,): 0 the person's top, 1 its end."""
        mean = np.where(height > FEET, CONTACT, MEAN).astype(np.float32)[:, None]
        w = np.where(height > LOW, self.low, self.high).astype(np.float32)[:, None]
        darker, brighter = np.maximum(1 - s, 0), np.maximum(s - 1, 0)
        k = (1 - w) * np.exp(-darker / mean) / mean + w / (1 - DARKEST)
        return k * np.exp(-brighter / BRIGHT)


def counted(image: np.ndarray, plate: Plate, bare: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Count pixels of a picture (h, w, 3) in [0, 1], high up and near the floor.

    Args:
        image: the picture.
        plate: the background in it.
        bare: where the person surely is not (h, w) bool.
        height: of each row (h,).

    Returns:
        (2, 3): all that are bare, those in deep and those in faint shadow.
    """
    s, bare = shade(image, plate), bare & plate.seen
    off = np.linalg.norm(image - s[..., None] * plate.color, axis=-1)
    hue = bare & (off < SAME_HUE * np.maximum(plate.spread, NOISE))
    kinds = bare, hue & (s < DEEP), hue & (s >= DEEP) & (s < FAINT)
    rows = height > LOW
    return np.array([[kind[part].sum() for kind in kinds] for part in (~rows, rows)])
