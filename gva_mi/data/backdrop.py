"""A person without what is behind them, also in the pixels that show both.

A pixel of the outline is of two colours, the person's F and the backdrop's B, in the shares that a
mask S tells:

1. ``I = S F + (1 - S) B``

Before another background, ``S I`` would keep ``S (1 - S) B`` of the old one: a bright seam around
everybody who was filmed before a white wall. What has to be kept is

2. ``S F = I - (1 - S) B``,   between 0 and ``S``

with B as seen beside the person: the mean around the nearest pixel in which S is nothing. Where the
mask is hard there are no such pixels, and ``S F = S I``.
"""

from __future__ import annotations

import numpy as np

AROUND = 3  # pixels, side of the squares whose mean is the backdrop
MARGIN = 8  # pixels around the mask, in which the backdrop is looked for
NOTHING = 0.5 / 255  # of a mask


def alone(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Eq. 2.

    Args:
        image: (H, W, 3) in [0, 1].
        mask: (H, W) in [0, 1].

    Returns:
        (H, W, 3), the person's colour times the mask; zero where the mask is.
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    person = np.zeros_like(image)
    rows, columns = (np.flatnonzero((mask > NOTHING).any(axis)) for axis in (1, 0))
    if not len(rows):
        return person
    part = tuple(slice(max(0, x[0] - MARGIN), x[-1] + 1 + MARGIN) for x in (rows, columns))
    I, S = image[part], mask[part][..., None]
    behind = (S < NOTHING).astype(I.dtype)
    if not behind.any():  # the backdrop is not seen
        person[part] = S * I
        return person
    share = uniform_filter(behind, (AROUND, AROUND, 1), mode="constant")
    mean = uniform_filter(behind * I, (AROUND, AROUND, 1), mode="constant")
    nearest = distance_transform_edt(
        behind[..., 0] == 0, return_distances=False, return_indices=True
    )
    B = (mean / share.clip(1e-6))[tuple(nearest)]
    person[part] = np.where(behind > 0, 0, (I - (1 - S) * B).clip(0, S))
    return person
