"""Value range of masks: 0 to 1, 0 to 255, 16 bits, or labels that are no masks.

One mask alone says little: a person who has left the picture has an empty one. Over all masks of a
video, some pixel must be inside and some outside.
"""

from __future__ import annotations

import numpy as np

from gva_mi.core.errors import InputError

BARELY = 127  # 8-bit masks above this are inside
_FEW = 6  # values that are named


def full_value(mask: np.ndarray) -> int:
    """Return the value that is fully inside: 1, 255, or 65535 if a mask has 16 bits."""
    most = mask.max(initial=0)
    if mask.dtype.kind == "b" or most <= 1:
        return 1
    return 65535 if mask.dtype == np.uint16 and most > 255 else 255


def to_8_bits(where: str, mask: np.ndarray, full: int) -> np.ndarray:
    """Convert a mask (H, W) to 8 bits, 255 inside; ``full`` is its value for fully inside."""
    low, high = (mask.min(), mask.max()) if mask.size else (0, 0)
    if not 0 <= low <= high <= full:  # NaN is neither
        raise InputError(
            f"{where}: its values go from {low:g} to {high:g}, such as a network's own before they "
            "are shares; expected Boolean, 0 to 1, or 0 to 255"
        )
    return np.round(mask.astype(np.float32) * (255 / full)).astype(np.uint8)


def require_person(where: str, counts: np.ndarray) -> None:
    """Refuse a video's masks if no pixel or every pixel is inside; ``counts`` (256,) per value."""
    values = np.flatnonzero(counts).tolist()
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
    if len(values) > _FEW:
        return f"values {values[0]} to {values[-1]}"
    *most, last = map(str, values)
    return f"values {', '.join(most)} and {last}" if most else f"the value {last}"
