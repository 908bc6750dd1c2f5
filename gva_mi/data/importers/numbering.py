"""Frame numbers: in the names of files, and in arrays that files hold."""

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

    It is the last number that differs between all of them, so that ``walk_2_000001_v3`` is 1.

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
    """Return the number that a source gave the first of ``count`` frames.

    Args:
        frames: (n,) the source's numbers.
        count: of the video.
        usual: the number that the program begins with; None: that of the pictures it was given.
        pictures: their names in order; None for a film.
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


def by_number(path: Path) -> tuple[int, str]:
    """Return a sort key: frame_2 before frame_10, names without a number first."""
    return (*numbers_in(path)[:1], -1)[0], path.name


def frame_numbers(value: Any) -> np.ndarray:  # noqa: ANN401
    """Convert an array in a file to frame numbers (n,).

    Raises:
        ValueError: they are not whole numbers.
    """
    numbers = np.ravel(value).astype(np.float64)
    if not (np.isfinite(numbers) & (numbers == np.floor(numbers))).all():
        raise ValueError("frames must be numbered by whole numbers")
    return numbers.astype(int)


def counted_from_0(names: Sequence[object], first: int = 0) -> list[int]:
    """Return the numbers in names of frames, counted from 0.

    They count from 0 or 1 if the least of them is that, and else from ``first``.
    """
    numbers = [number_in(name) for name in names]
    start = min(numbers, default=0)
    return [number - (start if start in (0, 1) else first) for number in numbers]
