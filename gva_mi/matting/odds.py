"""Evidence of each pixel: log odds of the person against the background.

A network's probability P, the densities of colours and the plate B decide together:

1. ``L = a logit(P) + b + log p(I | person) - log p(I | background)``
2. ``p(I | background) = (1 - e) [(1 - c) t3(I - B) + c t2(I - s B) k(s) / |B|] + e h(I)``

A share c of the background is in the person's shadow: s B is the nearest point to I on the line of
colours that B has in shadows, and k the density of s (eq. 3). Without the factor
``k(s) / |B|``, which says how thinly shadows are spread along that line, dark skin before wood
would be wood in a shadow. t3 and t2 are Student's densities in three dimensions, and in the two
across the line, since backgrounds are not quite still. h is the density of the background's colours
at this height, which reflections on a floor have, too. e is small where the plate was seen, and
large where it is a guess. The network errs at outlines and not in the middle of the person: b grows
with the distance from where P says anything else.

**Shadows.** A shadow multiplies the background by some s < 1 and leaves its hue. Under a sky or
several lamps it is faint: 1 - s is distributed exponentially, with a mean σ. The sun, or one lamp,
casts deep ones, of any s. With their share w of all shadows, the density of s is

3. ``k(s) = (1 - w) exp(-(1 - s) / σ) / σ + w / (1 - DARKEST)``,   ``s <= 1``

Above 1 it falls within BRIGHT. The video shows w where the person surely is not. Pixels there are
counted, high up and near the floor separately; of their shares in deep and in faint shadow,

4. ``w = deep / (deep + faint + FEW)``

**Colours.** A head and a shoe share few colours, and so do wall and floor. The density of a colour
is counted in bins of RGB, once for all heights and once for each of some bands from top to bottom,
and blurred, because few colours are seen exactly again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.matting.plate import Plate

BITS = 6  # of each channel: 64 bins
BANDS = 8  # of the height
BLUR = 1.0  # bins, standard deviation
ANYWHERE, UNKNOWN = 0.1, 0.05  # shares of the colours of all heights, and of any colour at all


class ColorsByHeight:
    """How likely a colour is at a height, of the person or of the background."""

    def __init__(self) -> None:
        bins = 1 << BITS
        self._count = np.zeros((BANDS, bins, bins, bins), np.float32)
        self._density: np.ndarray | None = None

    def add(self, image: np.ndarray, inside: np.ndarray, height: np.ndarray) -> None:
        """Count the colours of a picture (h, w, 3) 8-bit where ``inside`` (h, w) bool.

        ``height`` (h,) is that of each row: 0 at the top of the person, or of the grid, 1 at the
        bottom.
        """
        place = _band(height)[:, None], *np.moveaxis(image >> (8 - BITS), -1, 0)
        flat = np.ravel_multi_index(np.broadcast_arrays(*place), self._count.shape)
        counted = np.bincount(flat[inside], minlength=self._count.size)
        self._count += counted.reshape(self._count.shape)

    def density(self, image: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return the density (h, w) of a picture's colours, relative to a uniform one.

        Arguments are those of :meth:`add`.
        """
        if self._density is None:
            self._density = self._estimate()
        return self._density[_band(height)[:, None], *np.moveaxis(image >> (8 - BITS), -1, 0)]

    def _estimate(self) -> np.ndarray:
        """Blur and mix the counts, and scale them so that a uniform density is 1."""
        from scipy.ndimage import gaussian_filter

        smooth = gaussian_filter(self._count, (0.7, BLUR, BLUR, BLUR))
        every = smooth.sum(0, keepdims=True)
        share = lambda x: x / np.maximum(x.sum((1, 2, 3), keepdims=True), 1e-6)
        bins = self._count[0].size
        mixed = (1 - ANYWHERE - UNKNOWN) * share(smooth) + ANYWHERE * share(every)
        return (mixed * bins + UNKNOWN).astype(np.float32)


def _band(height: np.ndarray) -> np.ndarray:
    return np.clip((height * BANDS).astype(int), 0, BANDS - 1)


DARKEST, BRIGHTEST = 0.25, 1.15  # range of s
DEEP_SHADOW, FAINT_SHADOW = (
    0.75,
    0.9,
)  # s up to which a pixel counts as in a deep shadow, and in a faint one
FEW = 0.01  # share of pixels of both kinds below which videos hardly tell
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
        """Return eq. 4 of the sum (2, 3) of some :func:`counted`."""
        deep, faint = counts[:, 1:].T / np.maximum(counts[:, 0], 1)
        return Shadows(*(deep / (deep + faint + FEW)).tolist())

    def shaded(self, height: np.ndarray) -> np.ndarray:
        """Return the share (h, 1) of the background that is in shadow, of rows (h,) of heights."""
        return np.where(height > FEET, np.float32(AT_FEET), np.float32(SHADED))[:, None]

    def density(self, s: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return k (h, w), eq. 3, for rows of some heights (h,): 0 the person's top, 1 its end."""
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
    kinds = bare, hue & (s < DEEP_SHADOW), hue & (s >= DEEP_SHADOW) & (s < FAINT_SHADOW)
    rows = height > LOW
    return np.array([[kind[part].sum() for kind in kinds] for part in (~rows, rows)])


TRUST = 0.7  # a: the network's errors are alike in whole patches
CERTAIN = 5.0  # largest |logit| that is believed
MOST = 6.0  # largest log ratio of the two densities
SURE = 0.95  # probability of certainty, for b
# b is 0 up to the first distance and MIDDLE from the second on; both are shares of the person's
# height.
DEEP, DEEPEST, MIDDLE = 0.02, 0.05, 4.0
SEEN_ELSE, GUESS_ELSE = 0.01, 0.5  # e: share of colours that the plate does not explain
NU = 4.0  # degrees of freedom of t
T2, T3 = 0.1592, 0.0746  # Gamma((NU + D) / 2) / Gamma(NU / 2) / (NU pi)^(D / 2): densities at 0


def log_odds(
    image: np.ndarray,
    probability: np.ndarray,
    height: np.ndarray,
    plate: Plate,
    shadows: Shadows,
    person: np.ndarray,
    background: np.ndarray,
) -> np.ndarray:
    """Return L (h, w) float32, eq. 1.

    Args:
        image: I (h, w, 3) in [0, 1].
        probability: P (h, w) in [0, 1].
        height: of each row (h,): 0 at the person's highest pixel, 1 at the lowest.
        plate: the background in this picture.
        shadows: of the video.
        person: p(I | person) (h, w), relative to a uniform density.
        background: h(I) (h, w), likewise.
    """
    from scipy.ndimage import distance_transform_edt

    least = 1 / (1 + np.exp(CERTAIN))
    P = np.clip(probability, least, 1 - least)
    away = distance_transform_edt(probability > SURE) * (height[1] - height[0])
    middle = MIDDLE * ((away - DEEP) / (DEEPEST - DEEP)).clip(0, 1)
    ratio = np.log(person) - np.log(_of_background(image, height, plate, shadows, background))
    return (TRUST * np.log(P / (1 - P)) + middle + ratio.clip(-MOST, MOST)).astype(np.float32)


def _of_background(
    image: np.ndarray, height: np.ndarray, plate: Plate, shadows: Shadows, background: np.ndarray
) -> np.ndarray:
    """Return p(I | background) (h, w), eq. 2."""
    B, variance, s = plate.color, plate.spread**2, shade(image, plate)
    square = lambda x: np.einsum("ijk,ijk->ij", x, x)
    apart = lambda x: 1 + square(image - x) / (NU * variance)
    lit = T3 / plate.spread**3 * apart(B) ** (-(NU + 3) / 2)
    shaded = T2 / variance * apart(s[..., None] * B) ** (-(NU + 2) / 2)
    k = shadows.density(s, height) / np.sqrt(square(B) + variance)
    c = shadows.shaded(height)
    e = np.where(plate.seen, np.float32(SEEN_ELSE), np.float32(GUESS_ELSE))
    return (1 - e) * ((1 - c) * lit + c * shaded * k) + e * background
