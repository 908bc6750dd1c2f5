"""What is wrong with an outline, or from a frame to the next, as a share of the person's pixels.

An avatar is seen on white and on black, C₁ and C₀, which tells its alpha. S is the person's mask:

    1. A = 1 - mean over the colours of (C₁ - C₀)
    2. spill = Σ A [S is 0 within EDGE pixels] / Σ S            floaters, spikes, torn cloth
    3. holes = Σ (1 - A) [S is 1 within EDGE pixels] / Σ S      where the avatar comes apart

The border is left out, where an outline that is half a pixel off would outweigh everything. An
avatar that stands beside the person has both. And from one frame, of C and its picture I, to the
next, C' and I', the avatar may change where the person does not:

    4. flicker = Σ |(C' - C) - (I' - I)| / Σ S                  on white, mean over the colours

What is always wrong in the same place does not flicker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

EDGE = 2  # pixels on either side of the outline


@dataclass(frozen=True)
class Defects:
    """Of one picture, or the means over several."""

    spill: float
    holes: float

    @staticmethod
    def of(on_white: np.ndarray, on_black: np.ndarray, mask: np.ndarray) -> Defects:
        """Eq. 2 and 3 of one picture.

        Args:
            on_white: (H, W, 3) 8 bits, the avatar on white.
            on_black: the same on black.
            mask: (H, W) in [0, 1], the person, of whom something is seen.
        """
        from scipy.ndimage import maximum_filter, minimum_filter

        side = 2 * EDGE + 1
        alpha = 1 - (on_white.astype(np.float64) - on_black).mean(2) / 255
        away, inside = maximum_filter(mask, side) == 0, minimum_filter(mask, side) > 0.99
        person = mask.sum()
        return Defects(
            spill=float(alpha[away].sum() / person),
            holes=float((1 - alpha[inside]).sum() / person),
        )

    @staticmethod
    def mean(each: Sequence[Defects]) -> Defects:
        """The means over some pictures."""
        return Defects(*(float(np.mean([getattr(d, n) for d in each])) for n in ("spill", "holes")))


def flicker(
    renders: tuple[np.ndarray, np.ndarray],
    targets: tuple[np.ndarray, np.ndarray],
    mask: np.ndarray,
) -> float:
    """Eq. 4.

    Args:
        renders: the avatar in two frames, each (H, W, 3) 8 bits, on white.
        targets: the person in them, alike.
        mask: (H, W) in [0, 1], the person in one of them.
    """
    before, after = (c.astype(np.float64) - i for c, i in zip(renders, targets, strict=True))
    return float(np.abs(after - before).mean(2).sum() / 255 / mask.sum())
