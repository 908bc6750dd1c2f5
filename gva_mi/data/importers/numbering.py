"""Frame numbers: in the names of files, and in arrays that files hold."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np


def number_in(name: object, which: int = -1) -> int:
    """Return the last number in a file's name, usually the frame number; ``which`` 0: first.

    Raises:
        ValueError: there is none.
    """
    numbers = re.findall(r"\d+", Path(str(name)).stem)
    if not numbers:
        raise ValueError(f"no number in the name '{name}'")
    return int(numbers[which])


def by_number(path: Path) -> tuple[int, str]:
    """Return a sort key: frame_2 before frame_10, names without a number first."""
    numbers = re.findall(r"\d+", path.stem)
    return (int(numbers[-1]) if numbers else -1, path.name)


def frame_numbers(value: Any) -> np.ndarray:  # noqa: ANN401
    """Convert an array in a file to frame numbers (n,).

    Raises:
        ValueError: they are not whole numbers.
    """
    numbers = np.ravel(value).astype(np.float64)
    if not (np.isfinite(numbers) & (numbers == np.floor(numbers))).all():
        raise ValueError("frames must be numbered by whole numbers")
    return numbers.astype(int)
