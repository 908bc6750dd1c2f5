"""Evidence of each pixel: log odds of the person against the background.

A network's probability P, the densities of colours and the plate B decide together:

1. ``L = a logit(P) + b + log p(I | person) - log p(I | background)``
2. ``p(I | background) = (1 - e) t((I - s B) / spread) k(s) + e h(I)``

A shadow on the floor or on a wall multiplies B by some s < 1 and leaves its hue: eq. 2 takes the
best s, at a price k that grows with its distance from 1. t is Student's density, since backgrounds
are not quite still. h is the density of the background's colours at this height, which reflections
on a floor have, too. e is small where the plate was seen, and large where it is a guess. The
network errs at outlines and not in the middle of the person: b grows with the distance from where P
says anything else. Shadows are darkest where feet touch the floor, so the price k falls there.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import Plate

TRUST = 0.7  # a: the network's errors are alike in whole patches
CERTAIN = 5.0  # largest |logit| that is believed
MOST = 6.0  # largest log ratio of the two densities
SHADOW, CONTACT = 0.1, 0.4  # mean of 1 - s: anywhere, and below this height:
FEET = 0.92  # of the person, from the top
SURE = 0.95  # probability of certainty, for b
# b is 0 up to the first distance and MIDDLE from the second on; both are shares of the person's
# height.
DEEP, DEEPEST, MIDDLE = 0.02, 0.05, 4.0
BRIGHT = 0.02  # mean of s - 1: nothing shines on the background but what lights it anyway
DARKEST, BRIGHTEST = 0.25, 1.15  # range of s
SEEN_ELSE, GUESS_ELSE = 0.01, 0.5  # e: share of colours that the plate does not explain
NU = 4.0  # degrees of freedom of t
T3 = 0.0746  # Gamma((NU + 3) / 2) / Gamma(NU / 2) / (NU pi)^1.5: t at 0 in three dimensions


def log_odds(
    image: np.ndarray,
    probability: np.ndarray,
    height: np.ndarray,
    plate: Plate,
    person: np.ndarray,
    background: np.ndarray,
) -> np.ndarray:
    """Return L (h, w) float32, eq. 1.

    Args:
        image: I (h, w, 3) in [0, 1].
        probability: P (h, w) in [0, 1].
        height: of each row (h,): 0 at the person's highest pixel, 1 at the lowest.
        plate: the background in this picture.
        person: p(I | person) (h, w), relative to a uniform density.
        background: h(I) (h, w), likewise.
    """
    from scipy.ndimage import distance_transform_edt

    least = 1 / (1 + np.exp(CERTAIN))
    P = np.clip(probability, least, 1 - least)
    away = distance_transform_edt(probability > SURE) * (height[1] - height[0])
    middle = MIDDLE * ((away - DEEP) / (DEEPEST - DEEP)).clip(0, 1)
    shadow = np.where(height > FEET, CONTACT, SHADOW).astype(np.float32)[:, None]
    ratio = np.log(person) - np.log(_of_background(image, plate, background, shadow))
    return (TRUST * np.log(P / (1 - P)) + middle + ratio.clip(-MOST, MOST)).astype(np.float32)


def _of_background(
    image: np.ndarray, plate: Plate, background: np.ndarray, shadow: np.ndarray
) -> np.ndarray:
    """Return p(I | background) (h, w), eq. 2; ``shadow`` (h, 1) is the mean of 1 - s."""
    B, variance = plate.color, plate.spread**2
    dot = lambda x, y: np.einsum("ijk,ijk->ij", x, y)
    s = ((dot(image, B) + variance) / (dot(B, B) + variance)).clip(DARKEST, BRIGHTEST)
    rest = image - s[..., None] * B
    t = T3 / plate.spread**3 * (1 + dot(rest, rest) / (NU * variance)) ** (-(NU + 3) / 2)
    known = t * np.exp(np.minimum(s - 1, 0) / shadow - np.maximum(s - 1, 0) / BRIGHT)
    e = np.where(plate.seen, np.float32(SEEN_ELSE), np.float32(GUESS_ELSE))
    return (1 - e) * known + e * background
