"""Infer the numbers of frames from file names and from the arrays of other programs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


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
