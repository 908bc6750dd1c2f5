"""Read masks as segmenters write them: hard or soft, pictures or arrays.

========================  ====================================================
``000000.png``            8-bit: 0 and 255, or soft in between; or 0 and 1. Of colours,
                          palettes and alpha: :mod:`.mattes`
``000000.npy``            Boolean; 8-bit as above; or floating point in [0, 1]
========================  ====================================================

Where no mask of a folder has a value above 1, they hold zeros and ones.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array
from gva_mi.data.pictures import read_image


def read_mask(folder: Path, index: int) -> np.ndarray | None:
    """Read the mask of a frame, (H, W) float32 in [0, 1]; None without a file."""
    path = folder / f"{index:06d}.npy"
    if path.exists():
        mask = read_array(path)
    else:
        path = path.with_suffix(".png")
        if not path.exists():
            return None
        mask = read_image(path, 1)
    if mask.ndim != 2:
        raise InputError(f"{path}: a mask must be (H, W), got {mask.shape}")
    if mask.dtype == np.uint8:
        ones = mask.max(initial=0) == 1 and _holds_ones(folder, folder.stat().st_mtime_ns)
        return mask.astype(np.float32) / (1 if ones else 255)
    if mask.dtype == bool:
        return mask.astype(np.float32)
    if not np.issubdtype(mask.dtype, np.floating):
        raise InputError(f"{path}: a mask must be Boolean, 8-bit or float, got {mask.dtype}")
    if not ((mask >= 0) & (mask <= 1)).all():  # NaN is neither
        raise InputError(f"{path}: a floating-point mask must lie in [0, 1]")
    return mask.astype(np.float32)


@lru_cache(maxsize=16)
def _holds_ones(folder: Path, changed: int) -> bool:
    """Whether no 8-bit mask of a folder, last ``changed`` at that time, has a value above 1."""
    for path in sorted(folder.iterdir()):
        if path.suffix in (".npy", ".png"):
            mask = read_array(path) if path.suffix == ".npy" else read_image(path, 1)
            if mask.dtype == np.uint8 and mask.max(initial=0) > 1:
                return False
    return True
