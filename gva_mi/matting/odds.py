"""Log odds of each pixel, person against background, from a network and from colours.

A network's probability P, the densities of colours and the plate B decide together:

1. ``L = a logit(P) + b + f + log p(I | person) - log p(I | background)``
2. ``p(I | background) = (1 - e) [(1 - c) t3(I - B) + c t2(I - s B) k(s) / |B|] + e h(I)``

A share c of the background is in the person's shadow: s B is the nearest point to I on the line of
colours that B has in shadows, and k is the density of s (eq. 3). Without the factor
``k(s) / |B|``, which says how thinly shadows are spread along that line, dark skin before wood
would be wood in a shadow. t3 and t2 are Student's densities in three dimensions, and in the two
across the line, since backgrounds are not quite still. h is the density of the background's colours
at this height, which reflections on a floor have, too. e is small where the plate was seen, and
large where it is a guess. The network errs at outlines and not in the middle of the person: b grows
with the distance from where P says anything else. f keeps hands (eq. 5).

**Shadows.** A shadow multiplies the background by some s < 1 and leaves its hue. Under a sky or
several lamps it is faint: 1 - s is distributed exponentially with a mean σ. The sun, or one lamp,
casts deep shadows of any s from s_min to 1. With their share w of all shadows, the density of s is

3. ``k(s) = (1 - w) exp(-(1 - s) / σ) / σ + w / (1 - s_min)``,   ``s <= 1``

Above 1 it falls exponentially with the mean :data:`BRIGHTER_MEAN`. The video shows w where the
person surely is not. Pixels there are counted, high up and near the floor separately. From their
shares in deep and in faint shadow,

4. ``w = deep / (deep + faint + FEW_SHADOWS)``

**Colours.** A head and a shoe share few colours, and so do wall and floor. The density of a colour
is counted in bins of RGB, once for all heights and once per band from top to bottom,
and blurred, because few colours are seen exactly again.

**Hands.** They are anywhere between knees and head, so their height says little of their colours,
and P has few pixels for them. Landmarks show their bones. With the nearness n(r) to the bones
(:mod:`gva_mi.matting.hands`), a thin line along each is of the person, also before a wall of the
hand's colour, and around it the person has the colours of hands and forearms:

5. ``f = f_0 n(r_f)``
6. ``p(I | person) = (1 - q) p_height(I) + q p_hands(I)``,   ``q = q_0 n(r_q)``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.matting.plate import Plate

# Chosen: finer bins separate skin from a wall of a similar colour; the blur fills the empty ones.
COLOR_BITS = 6  # bits of each channel: 64 bins
COLOR_BLUR = 1.0  # bins, standard deviation
HEIGHT_BANDS = 8  # from top to bottom. Chosen: about the height of a head
BAND_BLUR = 0.7  # bands, standard deviation. Chosen: less than the distance of two bands
# Shares of the colours of all heights, and of any colour at all.
ANY_HEIGHT_SHARE, ANY_COLOR_SHARE = 0.1, 0.05


class ColorsByHeight:
    """How likely a colour is at a height, of the person or of the background."""

    def __init__(self) -> None:
        bins = 1 << COLOR_BITS
        self._count = np.zeros((HEIGHT_BANDS, bins, bins, bins), np.float32)
        self._density: np.ndarray | None = None

    def add(self, image: np.ndarray, inside: np.ndarray, height: np.ndarray) -> None:
        """Count the colours of a picture (h, w, 3) 8-bit where ``inside`` (h, w) bool.

        ``height`` (h,) is each row's: 0 at the top of the person (or of the grid), 1 at the bottom.
        """
        place = _band(height)[:, None], *np.moveaxis(image >> (8 - COLOR_BITS), -1, 0)
        flat = np.ravel_multi_index(np.broadcast_arrays(*place), self._count.shape)
        counted = np.bincount(flat[inside], minlength=self._count.size)
        self._count += counted.reshape(self._count.shape)

    def density(self, image: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return the density (h, w) of a picture's colours, relative to a uniform one.

        For the arguments see :meth:`add`.
        """
        if self._density is None:
            self._density = self._estimate()
        return self._density[_band(height)[:, None], *np.moveaxis(image >> (8 - COLOR_BITS), -1, 0)]

    def _estimate(self) -> np.ndarray:
        """Blur and mix the counts, and scale them so that a uniform density is 1."""
        from scipy.ndimage import gaussian_filter

        smooth = gaussian_filter(self._count, (BAND_BLUR, COLOR_BLUR, COLOR_BLUR, COLOR_BLUR))
        every = smooth.sum(0, keepdims=True)
        share = lambda x: x / np.maximum(x.sum((1, 2, 3), keepdims=True), 1e-6)
        bins = self._count[0].size
        same_height = 1 - ANY_HEIGHT_SHARE - ANY_COLOR_SHARE
        mixed = same_height * share(smooth) + ANY_HEIGHT_SHARE * share(every)
        return (mixed * bins + ANY_COLOR_SHARE).astype(np.float32)


# Chosen on two rendered videos, by the masks of hands. Radii are shares of the person's height.
BONE_BONUS, BONE_RADIUS = 6.0, 0.0035  # f_0, in the unit of L, and r_f: half a finger's width
HAND_COLORS, HAND_RADIUS = 0.8, 0.02  # q_0 and r_q of eq. 6: half a palm's width
NEAR_BONE = 0.5  # n(r_f) of pixels whose colours are counted as those of hands
LEAST_HAND_PIXELS = 64  # pixels of a video; fewer do not show the colours of hands


class PersonColors:
    """How likely a colour is of the person: by the height, and near the bones of hands (eq. 6)."""

    def __init__(self) -> None:
        self._by_height, self._of_hands = ColorsByHeight(), ColorsByHeight()
        self._hand_pixels = 0

    def add(
        self, image: np.ndarray, inside: np.ndarray, height: np.ndarray, at_bones: np.ndarray
    ) -> None:
        """Count the colours of a picture; ``at_bones`` (h, w) is n(r_f), the rest as above."""
        self._by_height.add(image, inside, height)
        hand = inside & (at_bones > NEAR_BONE)
        self._of_hands.add(image, hand, np.zeros_like(height))
        self._hand_pixels += int(hand.sum())

    def density(self, image: np.ndarray, height: np.ndarray, at_hands: np.ndarray) -> np.ndarray:
        """Return p(I | person) (h, w), relative to a uniform one; ``at_hands`` (h, w) is n(r_q)."""
        by_height = self._by_height.density(image, height)
        if self._hand_pixels < LEAST_HAND_PIXELS:
            return by_height
        q = HAND_COLORS * at_hands
        return (1 - q) * by_height + q * self._of_hands.density(image, np.zeros_like(height))


def _band(height: np.ndarray) -> np.ndarray:
    return np.clip((height * HEIGHT_BANDS).astype(int), 0, HEIGHT_BANDS - 1)


# Chosen. Heights are 0 at the person's top, 1 at the feet.
DARKEST_SHADOW, BRIGHTEST_SHADE = 0.25, 1.15  # smallest and largest s; s_min of eq. 3
DEEP_SHADOW, FAINT_SHADOW = 0.75, 0.9  # s below which a pixel counts as deep, and as faint
FEW_SHADOWS = 0.01  # share of pixels in shadow, deep or faint, below which eq. 4 tends to w = 0
SAME_HUE = 3.0  # standard deviations of the background's colour: a shadow's colour is off by less
LEAST_HUE_DEVIATION = 0.012  # of colours in [0, 1]: compression blurs the edges of shadows
FEET_HEIGHT = 0.92  # height below which the feet touch the floor
SHADED_SHARE, SHADED_SHARE_AT_FEET = 0.2, 0.5  # c of eq. 2: anywhere, at the feet
SHADOW_MEAN, SHADOW_MEAN_AT_FEET = 0.1, 0.4  # σ of eq. 3: anywhere, at the feet
FLOOR_HEIGHT = 0.8  # height below which w is the one near the floor
BRIGHTER_MEAN = 0.02  # mean of s - 1: small, because a person adds no light to the background


def shade(image: np.ndarray, plate: Plate) -> np.ndarray:
    """Return s (h, w), where s B is the point nearest to each pixel's colour (h, w, 3)."""
    B, variance = plate.color, plate.spread**2
    along = np.einsum("ijk,ijk->ij", image, B) + variance
    share = along / (np.einsum("ijk,ijk->ij", B, B) + variance)
    return share.clip(DARKEST_SHADOW, BRIGHTEST_SHADE)


@dataclass(frozen=True)
class Shadows:
    """Shares w of deep shadows: high up, and near the floor."""

    high: float = 0.0
    low: float = 0.0

    @staticmethod
    def of(counts: np.ndarray) -> Shadows:
        """Estimate both shares w (eq. 4) from summed counts (2, 3) of :func:`count_shadows`."""
        deep, faint = counts[:, 1:].T / np.maximum(counts[:, 0], 1)
        return Shadows(*(deep / (deep + faint + FEW_SHADOWS)).tolist())

    def shaded(self, height: np.ndarray) -> np.ndarray:
        """Return c (h, 1) of eq. 2, the background's share of shadow, for rows at heights (h,)."""
        c = np.where(height > FEET_HEIGHT, SHADED_SHARE_AT_FEET, SHADED_SHARE)
        return c.astype(np.float32)[:, None]

    def density(self, s: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return k (h, w), eq. 3, for rows at heights (h,): 0 the person's top, 1 the feet."""
        mean = np.where(height > FEET_HEIGHT, SHADOW_MEAN_AT_FEET, SHADOW_MEAN)
        w = np.where(height > FLOOR_HEIGHT, self.low, self.high)
        mean, w = (x.astype(np.float32)[:, None] for x in (mean, w))
        darker, brighter = np.maximum(1 - s, 0), np.maximum(s - 1, 0)
        k = (1 - w) * np.exp(-darker / mean) / mean + w / (1 - DARKEST_SHADOW)
        return k * np.exp(-brighter / BRIGHTER_MEAN)


def count_shadows(
    image: np.ndarray, plate: Plate, bare: np.ndarray, height: np.ndarray
) -> np.ndarray:
    """Count a picture's background pixels, and those in shadow, high up and near the floor.

    Args:
        image: the picture (h, w, 3) in [0, 1].
        plate: the background in it.
        bare: where the person surely is not (h, w) bool.
        height: of each row (h,).

    Returns:
        (2, 3): for each part, the bare pixels, those in deep shadow, those in faint shadow.
    """
    s, bare = shade(image, plate), bare & plate.seen
    off = np.linalg.norm(image - s[..., None] * plate.color, axis=-1)
    hue = bare & (off < SAME_HUE * np.maximum(plate.spread, LEAST_HUE_DEVIATION))
    kinds = bare, hue & (s < DEEP_SHADOW), hue & (s >= DEEP_SHADOW) & (s < FAINT_SHADOW)
    rows = height > FLOOR_HEIGHT
    return np.array([[kind[part].sum() for kind in kinds] for part in (~rows, rows)])


# Chosen, in the unit of L unless another one is named.
NETWORK_WEIGHT = 0.7  # a of eq. 1: below 1, because the network's errors are alike in whole patches
LARGEST_LOGIT = 5.0  # largest |logit(P)|: a network's probability beyond 0.993 is no evidence
# Largest |log ratio| of the two densities, so that one colour cannot decide.
LARGEST_LOG_RATIO = 6.0
SURE_PERSON = 0.95  # probability: b counts distances from pixels where P is less
# b is 0 up to the first distance and grows to its largest value at the second one.
INSIDE_FROM, INSIDE_FULL_FROM = 0.02, 0.05  # shares of the person's height
INSIDE_BONUS = 4.0  # largest b
UNEXPLAINED_WHERE_SEEN, UNEXPLAINED_WHERE_GUESSED = 0.01, 0.5  # e: share not of the plate
# Degrees of freedom ν of Student's t. Chosen: heavier tails than a Gaussian's.
STUDENT_FREEDOM = 4.0
# Student's densities at 0 in D dimensions: Γ((ν + D) / 2) / Γ(ν / 2) / (ν π)^(D / 2).
STUDENT_PEAK_2D, STUDENT_PEAK_3D = 0.1592, 0.0746


def log_odds(
    image: np.ndarray,
    probability: np.ndarray,
    height: np.ndarray,
    plate: Plate,
    shadows: Shadows,
    person: np.ndarray,
    background: np.ndarray,
    at_bones: np.ndarray,
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
        at_bones: n(r_f) (h, w) of eq. 5.
    """
    from scipy.ndimage import distance_transform_edt

    least = 1 / (1 + np.exp(LARGEST_LOGIT))
    P = np.clip(probability, least, 1 - least)
    away = distance_transform_edt(probability > SURE_PERSON) * (height[1] - height[0])
    middle = INSIDE_BONUS * ((away - INSIDE_FROM) / (INSIDE_FULL_FROM - INSIDE_FROM)).clip(0, 1)
    ratio = np.log(person) - np.log(_of_background(image, height, plate, shadows, background))
    return (
        NETWORK_WEIGHT * np.log(P / (1 - P))
        + middle
        + BONE_BONUS * at_bones
        + ratio.clip(-LARGEST_LOG_RATIO, LARGEST_LOG_RATIO)
    ).astype(np.float32)


def _of_background(
    image: np.ndarray, height: np.ndarray, plate: Plate, shadows: Shadows, background: np.ndarray
) -> np.ndarray:
    """Return p(I | background) (h, w), eq. 2."""
    B, variance, s = plate.color, plate.spread**2, shade(image, plate)
    square = lambda x: np.einsum("ijk,ijk->ij", x, x)
    apart = lambda x: 1 + square(image - x) / (STUDENT_FREEDOM * variance)
    lit = STUDENT_PEAK_3D / plate.spread**3 * apart(B) ** (-(STUDENT_FREEDOM + 3) / 2)
    shaded = STUDENT_PEAK_2D / variance * apart(s[..., None] * B) ** (-(STUDENT_FREEDOM + 2) / 2)
    k = shadows.density(s, height) / np.sqrt(square(B) + variance)
    c = shadows.shaded(height)
    e = np.where(plate.seen, UNEXPLAINED_WHERE_SEEN, UNEXPLAINED_WHERE_GUESSED).astype(np.float32)
    return (1 - e) * ((1 - c) * lit + c * shaded * k) + e * background
