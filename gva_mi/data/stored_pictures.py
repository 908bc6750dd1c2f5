"""Pictures of any number in a folder, of which none stays in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np


class StoredPictures(Sequence[np.ndarray]):
    """Pictures in the files of a folder, read one by one.

    Attributes:
        count: how many there are; zero until it is set.
    """

    def __init__(self, folder: Path, suffix: str, read: Callable[[Path], np.ndarray]) -> None:
        self._folder, self._suffix, self._read, self.count = folder, suffix, read, 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> np.ndarray:
        return self._read(self.path(index))

    def path(self, index: int) -> Path:
        """Return a picture's file."""
        return self._folder / f"{index:06d}{self._suffix}"
