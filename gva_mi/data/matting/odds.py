"""Evidence of each pixel: log odds of the person against the background.

A network's probability P, the densities of colours and the plate B decide together:

1. ``L = a logit(P) + b + log p(I | person) - log p(I | background)``
2. ``p(I | background) = (1 - e) [(1 - c) t3(I - B) + c t2(I - s B) k(s) / |B|] + e h(I)``

A share c of the background is in the person's shadow: s B is the nearest point to I on the line of
colours that B has in shadows, and k the density of s (:mod:`.shadows`). Without the factor
``k(s) / |B|``, which says how thinly shadows are spread along that line, dark skin before wood
would be wood in a shadow. t3 and t2 are Student's densities in three dimensions, and in the two
across the line, since backgrounds are not quite still. h is the density of the background's colours
at this height, which reflections on a floor have, too. e is small where the plate was seen, and
large where it is a guess. The network errs at outlines and not in the middle of the person: b grows
with the distance from where P says anything else.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import Plate
from gva_mi.data.matting.shadows import Shadows, shade

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
        shadows: of the film.
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
