"""Read masks as segmenters write them: hard or soft, pictures or arrays.

========================  ====================================================
``000000.png``            8 or 16 bits: hard, soft, or labels. For colours, palettes and
                          alpha see :mod:`.pictures`
``000000.npy``            Boolean; whole numbers as above; or floating point in [0, 1]
========================  ====================================================

The range of whole numbers (0 to 1, 0 to 255, 16 bits, or labels) is decided once for all masks of a
video. One mask is not enough: if the person has left the picture, it is empty, or it holds a
segmenter's noise of one step. So :func:`meaning_of` reads masks until one decides.

A few different whole numbers that stay far below the unit are labels. So are those in a drawing
with borders of 255, which belong to no object. The only label beside 0 is the person; several
labels are refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from gva_mi.core.console import listed
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array
from gva_mi.subject.folder import array_or_picture
from gva_mi.subject.pictures import VOID_LABEL, read_image

INSIDE_ABOVE = 127  # a pixel of an 8-bit mask with a larger value is inside
# Chosen: a mask of more different values is soft and dim, not a drawing of labels.
_LABEL_COUNT = 64
_FULL_SHARE = 0.98  # of the unit. Chosen: a mask that is fully inside somewhere reaches it


def read_mask(folder: Path, index: int) -> np.ndarray | None:
    """Read the mask of a frame, (H, W) float32 in [0, 1]; None without a file."""
    path = array_or_picture(folder, index)
    if not path.exists():
        return None
    mask = _values(path)
    if mask.ndim != 2:
        raise InputError(f"{path}: a mask must be (H, W), got {mask.shape}")
    if mask.dtype.kind in "iu":
        if not mask.any():
            return mask.astype(np.float32)
        meaning = _meaning(folder, folder.stat().st_mtime_ns, mask.dtype)
        return meaning.inside(str(path), mask).astype(np.float32) / 255
    if mask.dtype.kind not in "bf":
        raise InputError(f"{path}: a mask must be Boolean or numbers, got {mask.dtype}")
    if not ((mask >= 0) & (mask <= 1)).all():  # NaN is neither
        raise InputError(f"{path}: a floating-point mask must lie in [0, 1]")
    return mask.astype(np.float32)


def _values(path: Path) -> np.ndarray:
    return read_array(path) if path.suffix == ".npy" else read_image(path, 1)


@lru_cache(maxsize=16)
def _meaning(folder: Path, changed: int, dtype: np.dtype) -> MaskMeaning:
    """Return the meaning of a folder's masks of one type; ``changed`` renews the cache."""
    masks = (_values(x) for x in sorted(folder.glob("[!.]*")) if x.suffix in (".npy", ".png"))
    return meaning_of(mask for mask in masks if mask.dtype == dtype)


@dataclass(frozen=True)
class MaskMeaning:
    """The range of the values in a video's masks, or which of them is the person."""

    full: int = 255  # the value that is fully inside: 1, 255 or 65535
    label: int | None = None  # the person's, if it is the only one beside 0
    labels: tuple[int, ...] = ()  # several: which of them is the person is unknown
    parts: bool = False  # labels are parts of the person: all but zero are inside

    def inside(self, where: str, mask: np.ndarray) -> np.ndarray:
        """Convert a mask (H, W) to 8 bits, 255 inside."""
        if self.parts:
            return (mask > 0) * np.uint8(255)
        if self.labels:
            raise InputError(
                f"{where}: the masks hold the labels {listed(self.labels)}, and which one is the "
                "person is unknown; expected 255 inside the person: save (mask == label) * 255"
            )
        if self.label is not None:
            return (mask == self.label) * np.uint8(255)
        low, high = (mask.min(), mask.max()) if mask.size else (0, 0)
        if not 0 <= low <= high <= self.full:  # NaN is neither
            raise InputError(
                f"{where}: its values go from {low:g} to {high:g}, such as a network's logits; "
                "expected Boolean, 0 to 1, or 0 to 255"
            )
        if mask.dtype == np.uint8 and self.full == 255:
            return mask
        return np.round(mask.astype(np.float32) * (255 / self.full)).astype(np.uint8)


def meaning_of(masks: Iterable[np.ndarray]) -> MaskMeaning:
    """Decide the range of the values in a video's masks (H, W)."""
    full, whole = 1, set()  # whole: the labels; None: the values are no labels
    for mask in masks:
        if mask.dtype.kind == "b":
            return MaskMeaning(1)
        most = mask.max(initial=0)
        if most > 1:
            full = max(full, 65535 if mask.dtype == np.uint16 and most > 255 else 255)
        counts = None if whole is None else _whole_numbers(mask)
        if full > 1 and most >= _FULL_SHARE * full and not (counts and _drop_border(counts)):
            if mask.dtype == np.uint8 or full > 255:
                return MaskMeaning(full)  # no later mask says more
            counts = None
        whole = None if counts is None else whole | set(counts)
        whole = None if whole is None or len(whole) > _LABEL_COUNT else whole
    if full == 1 or whole is None:
        return MaskMeaning(full)
    labels = tuple(sorted(whole))
    if 0 in labels and len(labels) == 2:
        return MaskMeaning(label=labels[1])
    return MaskMeaning(label=labels[0]) if len(labels) == 1 else MaskMeaning(labels=labels)


def _drop_border(counts: dict[int, int]) -> bool:
    """Remove the border's value from the counts of a drawing of labels; False: it is no drawing."""
    labels = [count for value, count in counts.items() if 0 < value <= INSIDE_ABOVE]
    if max(counts) != VOID_LABEL or any(INSIDE_ABOVE < value < VOID_LABEL for value in counts):
        return False
    return sum(labels) > counts[VOID_LABEL] and bool(counts.pop(VOID_LABEL))


def _whole_numbers(mask: np.ndarray) -> dict[int, int] | None:
    """Count the values of a mask; None unless they are whole numbers from 0 on."""
    if mask.dtype == np.uint8:
        counts = np.bincount(mask.ravel(), minlength=256)
        return {int(value): int(counts[value]) for value in np.flatnonzero(counts)}
    if not (mask >= 0).all() or (mask.dtype.kind == "f" and (mask != np.floor(mask)).any()):
        return None
    values, counts = np.unique(mask, return_counts=True)
    return dict(zip(map(int, values), map(int, counts), strict=True))


def require_person(where: str, counts: np.ndarray) -> None:
    """Refuse a video's masks if no pixel or every pixel is inside; ``counts`` (256,) per value."""
    values = np.flatnonzero(counts).tolist()
    if not values or values[0] <= INSIDE_ABOVE < values[-1]:
        return
    what = f"no pixel of any mask is above half, the largest value is {values[-1]}"
    if values[0] > INSIDE_ABOVE:
        what = "every pixel of every mask is inside: opaque pictures, or masks of another video"
    raise InputError(f"{where}: {what}; expected 255 inside the person, and 0 outside")
