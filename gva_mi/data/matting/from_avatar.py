"""Correct a mask once by the first avatar fitted to it.

The avatar has learned from all pictures what belongs to the person: it has no hole where one mask
has one, and no shadow that only some masks hold. Its own outline is blurred and a little off. So
the mask stays where both agree but for an outline's width, and elsewhere the picture decides.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.film import extent
from gva_mi.data.matting.grid import WorkGrid
from gva_mi.data.matting.scene import FilmScene, GridPicture

OFF = 0.008  # of the person's height: how far the avatar's outline may be off
AROUND = 3  # pixels around a difference that are decided again, too


def mask_from_avatar(picture: np.ndarray, mask: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return a better mask (H, W) 8-bit.

    Args:
        picture: (H, W, 3) 8-bit.
        mask: the person's mask so far (H, W) 8-bit.
        alpha: the avatar's alpha (H, W) 8-bit, rendered in the picture's pose and camera.
    """
    from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

    vote = (mask.astype(np.float32) + alpha) / 2
    place = extent(vote)
    if not place[2]:
        return np.zeros_like(mask)
    off = OFF * (place[3] - place[1])
    width = max(1, round(off))
    differ = binary_erosion((mask > 127) != (alpha > 127), iterations=width)
    if not differ.any():
        return mask
    P = np.round(gaussian_filter(vote, off / 2)).astype(np.uint8)
    grid = WorkGrid.around(place[None], picture.shape[:2])
    view = GridPicture(
        grid.cut(picture), grid.cut(P).astype(np.float32) / 255, grid.heights(place), np.eye(3)
    )
    found = grid.paste(FilmScene.gather([view]).mask(view))
    return np.where(binary_dilation(differ, iterations=width + AROUND), found, mask)
