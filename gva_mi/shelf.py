"""``Shelf``: values by number, in memory as long as there is room and then in a file of its own.

Long videos make more of each frame than memory holds. The file has no name: it is gone with the
process, however that ends.
"""

from __future__ import annotations

import io
import os
import pickle
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

KEPT = 1 << 28  # bytes of values that stay in memory

T = TypeVar("T")


class Shelf(Mapping[int, T], Generic[T]):
    """Values that are put in one by one, and the same to the bit when they are looked at.

    Where it is sent to another process, it is sent as a plain dictionary of what it holds.
    """

    def __init__(self, folder: Path, kept: int = KEPT) -> None:
        """An empty one.

        Args:
            folder: where its file is, if it needs one: on the disk that results go to, for the
                system's folder of temporary files may be memory.
            kept: bytes of values that may stay in memory.
        """
        self._folder, self._room = folder, kept
        self._near: dict[int, T] = {}
        self._far: dict[int, tuple[int, int]] = {}  # where in the file, and how many bytes
        self._file: io.FileIO | None = None

    def __setitem__(self, number: int, value: T) -> None:
        """Add a value, or put it in another's place.

        Raises:
            OSError: the disk is full, with the folder's name.
        """
        stored = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        self._near.pop(number, None)
        self._far.pop(number, None)
        if len(stored) <= self._room:
            self._room -= len(stored)
            self._near[number] = value
            return
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)
            start = self._file.seek(0, os.SEEK_END)
            left = memoryview(stored)
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._folder)) from None
        self._far[number] = start, len(stored)

    def __getitem__(self, number: int) -> T:
        if number in self._near:
            return self._near[number]
        start, size = self._far[number]
        return pickle.loads(os.pread(self._file.fileno(), size, start))

    def __iter__(self) -> Iterator[int]:
        return iter(sorted([*self._near, *self._far]))

    def __len__(self) -> int:
        return len(self._near) + len(self._far)

    def __contains__(self, number: object) -> bool:
        return number in self._near or number in self._far

    def part(self, numbers: Iterable[int], first: int = 0) -> Part[T]:
        """Those of some values that are here, counted from ``first``, as they were put in."""
        return Part(self, {k - first: k for k in numbers if k in self})

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


class Part(Mapping[int, T], Generic[T]):
    """Some values of a shelf, under other numbers."""

    def __init__(self, of: Shelf[T], places: Mapping[int, int]) -> None:
        self._of, self._places = of, dict(places)

    def __getitem__(self, number: int) -> T:
        return self._of[self._places[number]]

    def __contains__(self, number: object) -> bool:
        return number in self._places

    def __iter__(self) -> Iterator[int]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)
