"""Remove the background's colour from a person's outline.

A pixel of the outline mixes two colours, the person's F and the background's B, by a mask S:

1. ``I = S F + (1 - S) B``

On another background, ``S I`` would keep ``S (1 - S) B`` of the old one: a bright seam around a
person filmed before a white wall. The part to keep is

2. ``S F = I - (1 - S) B``,   between 0 and ``S``

with B as seen beside the person. Where a mask is hard, ``S F = S I``.
"""

from __future__ import annotations

import numpy as np

# All chosen.
BACKGROUND_SQUARE = 3  # pixels, side of the squares whose mean colour continues the background
SEARCH_MARGIN = 8  # pixels around the mask in which the background is looked for
ZERO_MASK = 0.5 / 255  # half a step of 8 bits: a smaller mask is stored as zero


def premultiplied(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return eq. 2, the person's colour times the mask (H, W): (H, W, 3)."""
    person = np.zeros_like(image)
    rows, columns = (np.flatnonzero((mask > ZERO_MASK).any(axis)) for axis in (1, 0))
    if len(rows):
        part = tuple(
            slice(max(0, x[0] - SEARCH_MARGIN), x[-1] + 1 + SEARCH_MARGIN) for x in (rows, columns)
        )
        I, S = image[part], mask[part][..., None]
        person[part] = np.where(S < ZERO_MASK, 0, (I - (1 - S) * behind(I, S[..., 0])).clip(0, S))
    return person


def behind(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Estimate the background B (H, W, 3) of a picture (H, W, 3) with a mask (H, W), in [0, 1].

    B is the picture where the mask is zero, elsewhere the mean around the nearest such pixel;
    without any such pixel it is the picture itself.
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    bare = mask < ZERO_MASK
    if not bare.any():
        return image
    counts = bare[..., None].astype(image.dtype)
    share, total = (
        uniform_filter(x, (BACKGROUND_SQUARE, BACKGROUND_SQUARE, 1), mode="constant")
        for x in (counts, counts * image)
    )
    nearest = distance_transform_edt(~bare, return_distances=False, return_indices=True)
    return np.where(counts > 0, image, (total / share.clip(1e-6))[tuple(nearest)])


def unsure(mask: np.ndarray, width: float) -> np.ndarray:
    """Return where a mask (H, W) may be wrong: within ``width`` pixels of soft pixels and edges."""
    from scipy.ndimage import distance_transform_edt

    inside, both = mask > 0.5, (mask > ZERO_MASK) & (mask < 1 - ZERO_MASK)
    edge = (inside[1:] != inside[:-1], inside[:, 1:] != inside[:, :-1])
    both[1:] |= edge[0]
    both[:-1] |= edge[0]
    both[:, 1:] |= edge[1]
    both[:, :-1] |= edge[1]
    return distance_transform_edt(~both) <= width if both.any() else both
