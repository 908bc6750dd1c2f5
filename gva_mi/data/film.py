"""``Film``: the pictures of a video file, in any order, without all of them in memory at once.

A short film is decoded once and kept. Of a long one only the moments of its pictures are kept; a
picture is then decoded when it is asked for, from the key picture before it: the next one at once,
any other by way of at most as many pictures as lie between two key pictures.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.pictures import require_size
from gva_mi.errors import MALFORMED, InputError, reason_of

KEPT = 1 << 30  # bytes of pictures that are kept; 170 pictures of 1920 x 1080


class Film(Sequence[np.ndarray]):
    """The pictures of a video file, each (H, W, 3) 8-bit."""

    def __init__(self, path: Path, kept: int = KEPT) -> None:
        """Decode all of it once.

        Args:
            path: of the file.
            kept: bytes of pictures that may be kept.

        Raises:
            InputError: it cannot be decoded, or holds no picture.
        """
        self.path = Path(path)
        self.sizes: list[tuple[int, int]] = []  # (W, H) of each picture
        self._moments: list[int | None] = []
        self._keys: list[int] = []  # numbers of the key pictures
        self._images: list[np.ndarray] | None = []
        self._at: tuple[int, Iterator[Any], Any] | None = None  # the next one's number, and whence
        with self._open() as container:
            for frame in self._decoded(container):
                self._take(frame, kept)
        if not self.sizes:
            raise InputError(f"{path}: holds no picture")

    def __len__(self) -> int:
        return len(self.sizes)

    def __getitem__(self, index: int) -> np.ndarray:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        index %= len(self)
        if self._images is not None:
            return self._images[index]
        if self._at is None or not self._key_before(index) <= self._at[0] <= index:
            self._seek(index)
        number, frames, container = self._at
        for frame in frames:
            self._at = (number + 1, frames, container)
            if number == index:
                return frame.to_ndarray(format="rgb24")
            number += 1
        raise InputError(f"{self.path}: picture {index} was there, and cannot be decoded any more")

    def __getstate__(self) -> dict[str, Any]:
        """Without the open file, so that another process opens its own."""
        return self.__dict__ | {"_at": None}

    def _take(self, frame: Any, kept: int) -> None:  # noqa: ANN401
        """Note a picture that was decoded, and keep it as long as there is room."""
        require_size(str(self.path), frame.width, frame.height)
        if frame.key_frame:
            self._keys.append(len(self))
        self.sizes.append((frame.width, frame.height))
        self._moments.append(frame.pts)
        if 3 * frame.width * frame.height * len(self) > kept:
            self._images = None
        elif self._images is not None:
            self._images.append(frame.to_ndarray(format="rgb24"))

    def _key_before(self, index: int) -> int:
        """The key picture at or before a picture; the start, where none is known."""
        return self._keys[max(0, bisect_right(self._keys, index) - 1)] if self._keys else 0

    def _seek(self, index: int) -> None:
        """Go to the key picture at or before a picture, or to the start."""
        if self._at is not None:
            self._at[2].close()
        known = {moment: k for k, moment in enumerate(self._moments)}
        moment = self._moments[index]
        if moment is not None and len(known) == len(self):
            container = self._open()
            container.seek(moment, stream=container.streams.video[0])
            frames = self._decoded(container)
            first = next(frames, None)
            number = None if first is None else known.get(first.pts)
            if number is not None and number <= index:
                self._at = (number, _again(first, frames), container)
                return
            container.close()
        container = self._open()
        self._at = (0, self._decoded(container), container)

    def _open(self) -> Any:  # noqa: ANN401 (an import would cost everybody)
        import av

        try:
            container = av.open(str(self.path))
            stream = container.streams.video[0]
            require_size(str(self.path), stream.width, stream.height)
            return container
        except InputError:
            raise
        except (*MALFORMED, av.FFmpegError, OSError, MemoryError) as error:
            raise self._undecodable(error) from None

    def _decoded(self, container: Any) -> Iterator[Any]:  # noqa: ANN401
        import av

        try:
            yield from container.decode(video=0)
        except (*MALFORMED, av.FFmpegError, OSError, MemoryError) as error:
            raise self._undecodable(error) from None

    def _undecodable(self, error: Exception) -> InputError:
        return InputError(f"{self.path}: cannot be decoded as a video ({reason_of(error)})")


def _again(first: Any, frames: Iterator[Any]) -> Iterator[Any]:  # noqa: ANN401
    """Frames with one before them that was taken out already."""
    yield first
    yield from frames
