"""Read pictures and masks that a user names, from a video file, a folder or an array."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array
from gva_mi.subject.masks import MaskMeaning, meaning_of
from gva_mi.subject.numbering import numbers_in
from gva_mi.subject.pictures import matte_of_pixels, read_image
from gva_mi.subject.video_file import decoded, open_video_file, pixels_of, steps_of

Pictures = Path | tuple[Path, ...]  # a video file or a folder, or single files in order
SQUARE_PIXELS = 0.01  # of the logarithm of width over height. Chosen: nobody sees the difference
EVEN_STEP = 0.1  # of the time between pictures. Chosen: cameras of an even rate vary by less
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


def pictures(source: Pictures, channels: int) -> Iterator[np.ndarray]:
    """Yield the pictures of a video file, a folder or files, turned as their metadata say.

    ``channels`` is 3 for RGB (H, W, 3), or 1 for masks (H, W): :mod:`gva_mi.subject.pictures`.
    """
    files = files_of(source)
    if files is not None:
        for path in files:
            yield read_image(path, channels)
    elif source.suffix in (".npz", ".npy", ".pkl", ".pt"):
        raise InputError(
            f"{source}: expected a video file, a folder of pictures, or for masks a .npy (T, H, W)"
        )
    elif not source.is_file():
        raise InputError(f"{source}: no such video file or folder of pictures")
    else:
        for number, frame in enumerate(decoded(source)):
            if channels == 3:
                yield pixels_of(frame, "rgb24")
                continue
            has_alpha = any(component.is_alpha for component in frame.format.components)
            pixels = pixels_of(frame, "rgba" if has_alpha else "rgb24")
            yield matte_of_pixels(f"{source}: picture {number}", pixels)


def files_of(source: Pictures) -> list[Path] | None:
    """Return the picture files, sorted by the last number in their names; None for a video file."""
    if isinstance(source, tuple):
        return list(source)
    if not source.is_dir():
        return None
    files = [path for path in source.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES]
    if not files:
        raise InputError(f"{source}: holds no pictures ({', '.join(PICTURE_SUFFIXES)})")
    return sorted(files, key=_by_number)


def _by_number(path: Path) -> tuple[int, str]:
    """Return a sort key: frame_2 before frame_10, names without a number first."""
    return (*numbers_in(path)[:1], -1)[0], path.name


def folder_of(source: Pictures) -> Path:
    """Return the video file or the folder of pictures, for messages."""
    return source[0].parent if isinstance(source, tuple) else source


def masks(source: Pictures, meaning: MaskMeaning | None = None) -> Iterator[np.ndarray]:
    """Yield masks (H, W) 8-bit, 255 inside, from a video file, a folder, or a .npy (T, H, W).

    A folder may also hold a .npy (H, W) for each frame. ``meaning`` is the range of their values;
    None: it is decided from all masks.
    """
    meaning = mask_meaning(source) if meaning is None else meaning
    for where, mask in raw_masks(source):
        yield meaning.inside(where, mask)


def mask_meaning(source: Pictures) -> MaskMeaning:
    """Decide the range of the values in a source's masks."""
    return meaning_of(mask for _, mask in raw_masks(source))


def raw_masks(source: Pictures) -> Iterator[tuple[str, np.ndarray]]:
    """Yield a name for errors, and the stored values (H, W), of each mask."""
    whole = isinstance(source, Path)
    if whole and source.is_dir() and (files := sorted(source.glob("*.npy"), key=_by_number)):
        for path in files:
            yield str(path), _stack(path, read_array(path)[None])[0]
    elif whole and source.suffix == ".npy" and source.is_file():
        # Mapped anew each time: pages that were read through one mapping stay in memory with it.
        for k in range(len(_stack(source, read_array(source, mapped=True)))):
            yield f"{source}: mask {k}", _stack(source, read_array(source, mapped=True))[k]
    else:
        for k, mask in enumerate(pictures(source, 1)):
            yield f"{folder_of(source)}: mask {k}", mask


def _stack(path: Path, stack: np.ndarray) -> np.ndarray:
    """Open a stack of masks (T, H, W) of any number type."""
    one = [axis for axis in (1, 3) if stack.ndim == 4 and stack.shape[axis] == 1]
    stack = stack.squeeze(one[-1]) if one else stack  # the channels of a network's masks
    if stack.ndim != 3 or stack.dtype.kind not in "bufi":
        raise InputError(f"{path}: masks must be (T, H, W), got {stack.dtype} {stack.shape}")
    return stack


def count_of(source: Pictures) -> int:
    """Count the pictures of a video file, a folder or files, without decoding them."""
    files = files_of(source)
    return len(steps_of(source)[0]) + 1 if files is None else len(files)


def uneven_pixels(source: Pictures) -> str | None:
    """Return a note if a video file's pixels are not square."""
    if isinstance(source, tuple) or not source.is_file():
        return None
    with open_video_file(source) as container:
        ratio = float(container.streams.video[0].sample_aspect_ratio or 1)
    if abs(np.log(ratio or 1)) < SQUARE_PIXELS:
        return None
    return (
        f"the video's pixels are {ratio:.3g} times as wide as high, so that people look squeezed; "
        "convert it first: ffmpeg -i VIDEO -vf scale=iw*sar:ih,setsar=1 SQUARE.mp4"
    )


def uneven_rate(source: Pictures) -> str | None:
    """Return a note if a video file's frame rate varies; each picture still is one frame."""
    if isinstance(source, tuple) or not source.is_file():
        return None
    varies = varying(*steps_of(source))
    return varies and f"{varies}; each is one frame, as if the rate were even"


def varying(steps: np.ndarray, tick: float) -> str | None:
    """Return a sentence if the seconds (T − 1,) between pictures vary; ``tick`` is in seconds."""
    usual = float(np.median(steps)) if len(steps) else 0.0
    # Time stamps are whole ticks: with ticks of 1 ms, 30 pictures a second are 33 or 34 ms apart.
    if not len(steps) or np.abs(steps - usual).max() <= max(EVEN_STEP * usual, 1.5 * tick):
        return None
    least, most = 1000 * steps.min(), 1000 * steps.max()
    return f"the video's frame rate varies: its pictures are {least:.3g} to {most:.3g} ms apart"
