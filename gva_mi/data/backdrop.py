"""What is behind a person, near their outline, and the person without it.

A pixel of the outline is of two colours, the person's F and the backdrop's B, in the shares that a
mask S tells:

1. ``I = S F + (1 - S) B``

Before another background, ``S I`` would keep ``S (1 - S) B`` of the old one: a bright seam around
everybody who was filmed before a white wall. What has to be kept is

2. ``S F = I - (1 - S) B``,   between 0 and ``S``

with B as seen beside the person. Where a mask is hard there are no such pixels, and ``S F = S I``.
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
    person = np.zeros_like(image)
    rows, columns = (np.flatnonzero((mask > NOTHING).any(axis)) for axis in (1, 0))
    if len(rows):
        part = tuple(slice(max(0, x[0] - MARGIN), x[-1] + 1 + MARGIN) for x in (rows, columns))
        I, S = image[part], mask[part][..., None]
        person[part] = np.where(S < NOTHING, 0, (I - (1 - S) * behind(I, S[..., 0])).clip(0, S))
    return person


def behind(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """B: the picture where the mask is nothing; elsewhere the mean around the nearest such pixel.

    Args:
        image: (H, W, 3) in [0, 1].
        mask: (H, W) in [0, 1]; the picture is taken as it is where no pixel is nothing.

    Returns:
        (H, W, 3).
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    bare = mask < NOTHING
    if not bare.any():
        return image
    counts = bare[..., None].astype(image.dtype)
    share, total = (
        uniform_filter(x, (AROUND, AROUND, 1), mode="constant") for x in (counts, counts * image)
    )
    nearest = distance_transform_edt(~bare, return_distances=False, return_indices=True)
    return np.where(counts > 0, image, (total / share.clip(1e-6))[tuple(nearest)])


def unsure(mask: np.ndarray, width: float) -> np.ndarray:
    """Pixels (H, W) in which a mask (H, W) may be wrong: those that it says are of both, those at
    the edge between inside and outside, and all that are no farther than ``width`` from them."""
    from scipy.ndimage import distance_transform_edt

    inside, both = mask > 0.5, (mask > NOTHING) & (mask < 1 - NOTHING)
    edge = (inside[1:] != inside[:-1], inside[:, 1:] != inside[:, :-1])
    both[1:] |= edge[0]
    both[:-1] |= edge[0]
    both[:, 1:] |= edge[1]
    both[:, :-1] |= edge[1]
    return distance_transform_edt(~both) <= width if both.any() else both
