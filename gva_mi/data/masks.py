"""Read masks as segmenters write them: hard or soft, pictures or arrays.

========================  ====================================================
``000000.png``            8 or 16 bits: hard, or soft in between; or labels. Of colours,
                          palettes and alpha: :mod:`.mattes`
``000000.npy``            Boolean; whole numbers as above; or floating point in [0, 1]
========================  ====================================================

What whole numbers mean is decided once for all masks of a folder: :mod:`.mask_units`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array
from gva_mi.data.mask_units import MaskMeaning, meaning_of
from gva_mi.data.pictures import read_image


def read_mask(folder: Path, index: int) -> np.ndarray | None:
    """Read the mask of a frame, (H, W) float32 in [0, 1]; None without a file."""
    path = folder / f"{index:06d}.npy"
    path = path if path.exists() else path.with_suffix(".png")
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
    """Return what the masks of one kind mean in a folder that was ``changed`` last at that time."""

    def alike() -> Iterator[np.ndarray]:
        for path in sorted(folder.iterdir()):
            if path.suffix in (".npy", ".png") and (mask := _values(path)).dtype == dtype:
                yield mask

    return meaning_of(alike())
