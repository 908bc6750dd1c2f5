"""Pictures and masks as people keep them: a film, a folder in any numbering, an array."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gva_mi.data.importers.hdf5 import SUFFIXES, rows_of_hdf5
from gva_mi.data.importers.recordings import Pictures
from gva_mi.data.pictures import decoded, opened, to_8_bits
from gva_mi.errors import InputError
from gva_mi.files import read_array

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


def pictures(source: Pictures, channels: int) -> Iterator[np.ndarray]:
    """The pictures of a film or of a folder, one by one, turned as their metadata say.

    Args:
        source: a film, a folder, whose files go by the last number in their names, or files.
        channels: 3 for (H, W, 3), 1 for (H, W), 8-bit; a mask may be a picture's alpha.

    Raises:
        InputError: nothing is there, or it cannot be decoded.
    """
    if isinstance(source, tuple):
        for path in source:
            yield _picture(path, channels)
    elif source.is_dir():
        files = [path for path in source.iterdir() if path.suffix.lower() in PICTURES]
        if not files:
            raise InputError(f"{source}: holds no pictures ({', '.join(PICTURES)})")
        for path in sorted(files, key=_in_order):
            yield _picture(path, channels)
    elif source.is_file():
        yield from _film(source, channels)
    else:
        raise InputError(f"{source}: no such film or folder of pictures")


def masks(source: Pictures) -> Iterator[np.ndarray]:
    """The masks of a film, a folder, or a stack (T, H, W): each (H, W) 8-bit, 255 inside.

    A stack is a .npy, or ``masks`` in a .hdf5; a folder may hold a .npy (H, W) a frame. Values
    are labels where a picture has a palette, or where none is above 1.

    Raises:
        InputError: nothing is there, or it is of another form.
    """
    whole = isinstance(source, Path)
    if whole and source.suffix in SUFFIXES and source.is_file():
        rows = rows_of_hdf5(source, "masks")
        yield from (_scaled(mask, _counts_to_one(mask)) for mask in rows)
        return
    if whole and source.is_dir() and (files := sorted(source.glob("*.npy"), key=_in_order)):
        for path in files:
            mask = _stack(path, read_array(path)[None])[0]
            yield _scaled(mask, _counts_to_one(mask))
        return
    if whole and source.suffix == ".npy" and source.is_file():
        rows = _rows_of_npy(source)
        ones = all(_counts_to_one(mask) for mask in rows())
        yield from (_scaled(mask, ones) for mask in rows())
        return
    for mask in pictures(source, 1):
        yield mask * np.uint8(255) if mask.max(initial=0) <= 1 else mask


def _stack(path: Path, stack: np.ndarray) -> np.ndarray:
    """Masks (T, H, W) of any numbers."""
    stack = stack[..., 0] if stack.ndim == 4 and stack.shape[-1] == 1 else stack
    if stack.ndim != 3 or stack.dtype.kind not in "bufi":
        raise InputError(f"{path}: masks must be (T, H, W), got {stack.dtype} {stack.shape}")
    return stack


def _rows_of_npy(path: Path) -> Callable[[], Iterator[np.ndarray]]:
    """The masks of a stack, from the first on, of which one at a time is in memory."""
    whole = _stack(path, read_array(path, mapped=True))

    def rows() -> Iterator[np.ndarray]:
        for k in range(len(whole)):
            # Mapped anew, for pages that were read of one mapping stay in memory with it.
            yield _stack(path, read_array(path, mapped=True))[k]

    return rows


def _counts_to_one(mask: np.ndarray) -> bool:
    """Whether a mask counts from 0 to 1, and not to 255."""
    return mask.dtype.kind == "b" or mask.max(initial=0) <= 1


def _scaled(mask: np.ndarray, ones: bool) -> np.ndarray:
    """A mask of 8 bits."""
    return np.clip(mask.astype(np.float32) * (255 if ones else 1), 0, 255).astype(np.uint8)


def _in_order(path: Path) -> tuple[int, str]:
    """The last number in a name, as people number frames: frame_2 before frame_10."""
    numbers = re.findall(r"\d+", path.stem)
    return (int(numbers[-1]) if numbers else -1, path.name)


def _picture(path: Path, channels: int) -> np.ndarray:
    from PIL import ImageOps

    with opened(path) as stored:
        image = ImageOps.exif_transpose(stored)
        if channels == 1 and image.mode == "P":
            return (np.asarray(image) > 0) * np.uint8(255)
        image = to_8_bits(image)
        if channels == 1 and image.mode in ("LA", "RGBA"):
            return np.asarray(image.getchannel("A"))
        return np.asarray(image.convert("RGB" if channels == 3 else "L"))


def _film(path: Path, channels: int) -> Iterator[np.ndarray]:
    for frame in decoded(path):
        turns = round(getattr(frame, "rotation", 0) / 90) % 4  # counter-clockwise
        image = frame.to_ndarray(format="rgb24" if channels == 3 else "gray")
        yield np.ascontiguousarray(np.rot90(image, turns))
