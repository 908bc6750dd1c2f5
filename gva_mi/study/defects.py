"""Defects of an outline, and flicker between frames, as shares of the person's pixels.

An avatar rendered on white and on black, C₁ and C₀, shows its alpha A. S is the person's mask:

    1. A = 1 - mean over the colours of (C₁ - C₀)
    2. spill = Σ A [S is 0 within EDGE pixels] / Σ S            floaters, spikes, torn cloth
    3. holes = Σ (1 - A) [S is 1 within EDGE pixels] / Σ S      where the avatar comes apart

The border is left out, because an outline that is half a pixel off would outweigh everything. From
one frame, of render C and picture I, to the next, C' and I', the avatar may change although the
person does not; an error that stays in its place does not flicker:

    4. flicker = Σ |(C' - C) - (I' - I)| / Σ S                  on white, mean over the colours
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

EDGE = 2  # pixels on either side of the outline


@dataclass(frozen=True)
class Defects:
    """Defects of one picture, or their means over several."""

    spill: float
    holes: float

    @staticmethod
    def of(on_white: np.ndarray, on_black: np.ndarray, mask: np.ndarray) -> Defects:
        """Evaluate eq. 2 and 3 on 8-bit renders (H, W, 3) and the person's mask (H, W)."""
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
        """Return the means over some pictures."""
        return Defects(*(float(np.mean([getattr(d, n) for d in each])) for n in ("spill", "holes")))


def flicker(
    renders: tuple[np.ndarray, np.ndarray],
    targets: tuple[np.ndarray, np.ndarray],
    mask: np.ndarray,
) -> float:
    """Evaluate eq. 4 on 8-bit images (H, W, 3) of two frames, and the mask (H, W) of one."""
    before, after = (c.astype(np.float64) - i for c, i in zip(renders, targets, strict=True))
    return float(np.abs(after - before).mean(2).sum() / 255 / mask.sum())
