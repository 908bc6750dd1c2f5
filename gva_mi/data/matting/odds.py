"""Evidence of each pixel: log odds of the person against the background.

A network's probability P, the densities of colours and the plate B decide together:

1. ``L = a logit(P) + log p(I | person) - log p(I | background)``
2. ``p(I | background) = (1 - e) t((I - s B) / spread) k(s) + e h(I)``

A shadow on the floor or on a wall multiplies B by some s < 1 and leaves its hue: eq. 2 takes the
best s, at a price k that grows with its distance from 1. t is Student's density, since backgrounds
are not quite still. Where the plate was seen, h is 1 and e is small; where it is a guess, h is the
density of the background's colours at this height.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import Plate

TRUST = 0.5  # a: the network's errors are alike in whole patches
CERTAIN = 5.0  # largest |logit| that is believed
MOST = 6.0  # largest log ratio of the two densities
SHADOW = 0.15  # mean of |1 - s|
DARKEST, BRIGHTEST = 0.25, 1.15  # range of s
SEEN_ELSE, GUESS_ELSE = 0.01, 0.5  # e: share of colours that the plate does not explain
NU = 4.0  # degrees of freedom of t
T3 = 0.0746  # Gamma((NU + 3) / 2) / Gamma(NU / 2) / (NU pi)^1.5: t at 0 in three dimensions


def log_odds(
    image: np.ndarray,
    probability: np.ndarray,
    plate: Plate,
    person: np.ndarray,
    background: np.ndarray,
) -> np.ndarray:
    """Return L (h, w) float32, eq. 1.

    Args:
        image: I (h, w, 3) in [0, 1].
        probability: P (h, w) in [0, 1].
        plate: the background in this picture.
        person: p(I | person) (h, w), relative to a uniform density.
        background: h(I) (h, w), likewise.
    """
    least = 1 / (1 + np.exp(CERTAIN))
    P = np.clip(probability, least, 1 - least)
    ratio = np.log(person) - np.log(_of_background(image, plate, background))
    return (TRUST * np.log(P / (1 - P)) + np.clip(ratio, -MOST, MOST)).astype(np.float32)


def _of_background(image: np.ndarray, plate: Plate, background: np.ndarray) -> np.ndarray:
    """Return p(I | background) (h, w), eq. 2."""
    B, variance = plate.color, plate.spread**2
    dot = lambda x, y: np.einsum("ijk,ijk->ij", x, y)
    s = ((dot(image, B) + variance) / (dot(B, B) + variance)).clip(DARKEST, BRIGHTEST)
    rest = image - s[..., None] * B
    t = T3 / plate.spread**3 * (1 + dot(rest, rest) / (NU * variance)) ** (-(NU + 3) / 2)
    known = t * np.exp(-np.abs(1 - s) / SHADOW)
    e = np.where(plate.seen, SEEN_ELSE, GUESS_ELSE)
    return (1 - e) * known + e * np.where(plate.seen, 1, background)
