"""A cache for values of frames: in memory while there is room, then in an unnamed file.

Data derived from the frames of a long video does not fit into memory. The file has no name, so it
vanishes with the process however that ends.
"""

from __future__ import annotations

import os
import pickle
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Generic, NamedTuple, TypeVar

from gva_mi.core.atomic import with_filename

# Bytes of values that stay in memory. Chosen: 256 MB, little beside the gigabyte of a process.
BYTES_IN_MEMORY = 1 << 28

T = TypeVar("T")


class _OnDisk(NamedTuple):
    """The place of a pickled value."""

    file: BinaryIO
    start: int
    size: int


class SpillCache(Mapping[int, T], Generic[T]):
    """A mapping from frame numbers to values, which come back bit-identical.

    It is pickled as a plain dictionary of its values.

    Example:
        >>> cache = SpillCache(Path("."), kept=0)  # all values in a file
        >>> cache[3] = "a value"
        >>> cache[3], len(cache)
        ('a value', 1)

    Args:
        folder: where the file lies if one is needed; on the disk that results go to, because the
            system's folder for temporary files may be in memory.
        kept: bytes of values that stay in memory; None: :data:`BYTES_IN_MEMORY`.
    """

    def __init__(self, folder: Path, kept: int | None = None) -> None:
        self._folder, self._room = folder, BYTES_IN_MEMORY if kept is None else kept
        self._entries: dict[int, T | _OnDisk] = {}
        self._file: BinaryIO | None = None

    def __setitem__(self, number: int, value: T) -> None:
        """Add or replace a value; a full disk raises OSError with the folder's name."""
        stored = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        if len(stored) <= self._room:
            self._room -= len(stored)
            self._entries[number] = value
            return
        with with_filename(self._folder):
            self._file = self._file or tempfile.TemporaryFile(dir=self._folder)
            start = self._file.seek(0, os.SEEK_END)
            self._file.write(stored)
            self._file.flush()
        self._entries[number] = _OnDisk(self._file, start, len(stored))

    def __getitem__(self, number: int) -> T:
        entry = self._entries[number]
        if isinstance(entry, _OnDisk):
            return pickle.loads(os.pread(entry.file.fileno(), entry.size, entry.start))
        return entry

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._entries))

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, number: object) -> bool:
        return number in self._entries

    def part(self, numbers: Iterable[int], first: int = 0) -> SpillCache[T]:
        """Return the entries of these numbers that exist, renumbered from ``first``; no copies."""
        found = SpillCache(self._folder, 0)
        found._entries = {k - first: self._entries[k] for k in numbers if k in self._entries}
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)
