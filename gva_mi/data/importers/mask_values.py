"""``MaskValues``: what all masks of a video hold together, which tells labels from masks.

One mask alone tells little: a person who has left the picture has an empty one. Of all of them,
some pixel must be inside, and some outside.
"""

from __future__ import annotations

import numpy as np

from gva_mi.errors import InputError

BARELY = 127  # 8-bit masks above this are inside
_FEW = 6  # values that are named


class MaskValues:
    """How often each value (0 to 255) stands in the masks that were seen."""

    def __init__(self) -> None:
        self.counts = np.zeros(256, np.int64)

    def see(self, mask: np.ndarray) -> None:
        """Count a mask's values, (H, W) 8-bit."""
        self.counts += np.bincount(mask.ravel(), minlength=256)

    def require_person(self, where: str) -> None:
        """Refuse masks of which no pixel is inside, or all are.

        Raises:
            InputError: so it is, with the values and what they may be.
        """
        values = np.flatnonzero(self.counts).tolist()
        if not values or values[0] <= BARELY < values[-1]:
            return
        if values == [0]:
            what = "all masks are empty: every pixel is 0; expected 255 inside the person"
        elif values[0] > BARELY:
            what = (
                f"all masks are full, of {_named(values)} alone: opaque pictures, or of another "
                "video? Expected 255 inside the person, and 0 outside"
            )
        else:
            what = (
                f"no pixel of any mask is above half, they hold {_named(values)}: labels? 255 is "
                "inside; save (label == the person's) * 255"
            )
        raise InputError(f"{where}: {what}")


def _named(values: list[int]) -> str:
    """Values for people."""
    if len(values) > _FEW:
        return f"values {values[0]} to {values[-1]}"
    *most, last = map(str, values)
    return f"values {', '.join(most)} and {last}" if most else f"the value {last}"
