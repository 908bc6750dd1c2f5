"""Read pictures and masks that a user names, from a video file, a folder or an array.

The numbers of frames are inferred from file names, here and for the arrays of other programs.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import once_a_file, read_array
from gva_mi.subject.folder import FRAMES
from gva_mi.subject.masks import MaskMeaning, meaning_of
from gva_mi.subject.pictures import matte_of_pixels, read_image
from gva_mi.subject.video_file import VideoFile, decoded, open_stream, picture_of

Pictures = Path | tuple[Path, ...]  # a video file or a folder, or single files in order
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
    else:
        for number, frame in enumerate(decoded(open_stream(source))):
            image = picture_of(frame)
            where = f"{source}: picture {number}"
            yield matte_of_pixels(where, image) if channels == 1 else image


def files_of(source: Pictures) -> list[Path] | None:
    """Return the picture files, sorted by the numbers in their names; None for a video file."""
    if isinstance(source, tuple):
        return list(source)
    if not source.is_dir():
        return None
    if (source / FRAMES).is_dir():
        raise InputError(f"{source}: is a subject's folder; its pictures are {source / FRAMES}")
    files = [x for x in source.glob("[!.]*") if x.suffix.lower() in PICTURE_SUFFIXES]
    if not files:
        raise InputError(f"{source}: holds no pictures ({', '.join(PICTURE_SUFFIXES)})")
    return _in_order(files)


def _in_order(files: Collection[Path]) -> list[Path]:
    """Sort files by the frame numbers in their names, those without one first.

    Raises:
        InputError: two files have the same number.
    """
    named = [path for path in files if numbers_in(path)]
    numbers = dict(zip(named, frames_named(named).tolist(), strict=True))
    files = sorted(files, key=lambda path: (numbers.get(path, -1), path.name))
    for one, other in pairwise(files):
        if numbers.get(one) == numbers.get(other, -1):
            raise InputError(
                f"{other}: has the number {numbers[one]}, as {one.name}; expected one file a frame"
            )
    return files


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
    if whole and source.is_dir() and (files := _in_order(list(source.glob("[!.]*.npy")))):
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
    """Count the pictures of a video file, a folder or files."""
    files = files_of(source)
    return _video_facts(source)[0] if files is None else len(files)


def notes_of(source: Pictures) -> list[str]:
    """Return sentences on a video file that is unusual; each of its pictures still is one frame."""
    return list(_video_facts(source)[1]) if files_of(source) is None else []


@once_a_file
def _video_facts(path: Path) -> tuple[int, tuple[str, ...]]:
    """Decode a video file; return the number of its pictures, and notes."""
    video = VideoFile(path, kept=0)
    times = np.zeros(0) if video.times is None else video.times
    varies = varying(np.diff(times), video.tick)
    uneven = [f"{varies}; each is one frame, as if the rate were even"] if varies else []
    return len(video), (*video.notes, *uneven)


def varying(steps: np.ndarray, tick: float) -> str | None:
    """Return a sentence if the seconds (T − 1,) between pictures vary; ``tick`` is in seconds."""
    usual = float(np.median(steps)) if len(steps) else 0.0
    # Time stamps are whole ticks: with ticks of 1 ms, 30 pictures a second are 33 or 34 ms apart.
    if not len(steps) or np.abs(steps - usual).max() <= max(EVEN_STEP * usual, 1.5 * tick):
        return None
    least, most = 1000 * steps.min(), 1000 * steps.max()
    return f"the video's frame rate varies: its pictures are {least:.3g} to {most:.3g} ms apart"


def numbers_in(name: object) -> list[int]:
    """Return the numbers in a file's name, without its suffix, from the last to the first."""
    return [int(x) for x in re.findall(r"\d+", Path(str(name)).stem)[::-1]]


def number_in(name: object) -> int:
    """Return the last number in a file's name, usually the frame number.

    Raises:
        ValueError: there is none.
    """
    for number in numbers_in(name):
        return number
    raise ValueError(f"no number in the name '{name}'")


def frames_named(names: Sequence[object]) -> np.ndarray:
    """Return the frame numbers (n,) in the names of n files.

    It is the last number that differs in all names; without one, the last number. In files such as
    ``walk_2_000001_v3`` it is the 1.

    Raises:
        ValueError: a name has no number.
    """
    last = [number_in(name) for name in names]
    columns = zip(*map(numbers_in, names), strict=False)
    different = (x for x in columns if len(set(x)) == len(set(map(str, names))))
    return np.array(next(different, last))


def first_number(
    frames: np.ndarray, count: int, usual: int | None, pictures: Sequence[object] | None
) -> int:
    """Infer the number that a source gave the video's first frame.

    Args:
        frames: (n,) the source's numbers.
        count: of the video's frames.
        usual: the number that the program begins with; None: the number in the picture's name.
        pictures: names of the pictures in order; None for a video file.
    """
    fits = range(int(frames.max()) - count + 1, int(frames.min()) + 1)
    if usual is None and pictures is not None:
        try:
            named = frames_named(pictures)
            usual = int(named[0]) if np.isin(frames, named).all() else None
        except ValueError:
            usual = None
    guesses = (usual or 0, 0, 1, *(fits if len(fits) == 1 else ()))
    return next((x for x in guesses if x in fits and x >= 0), 0)


def frame_numbers(value: Any) -> np.ndarray:  # noqa: ANN401
    """Convert an array in a file to frame numbers (n,).

    Raises:
        ValueError: they are not whole numbers.
    """
    numbers = np.ravel(value).astype(np.float64)
    if not (np.isfinite(numbers) & (numbers == np.floor(numbers))).all():
        raise ValueError("frames must be numbered by whole numbers")
    return numbers.astype(int)


def counted_from_0(names: Sequence[object]) -> list[int]:
    """Return the numbers in names of frames; if the smallest is 1, one less each."""
    numbers = [number_in(name) for name in names]
    return [number - (min(numbers) == 1) for number in numbers]
