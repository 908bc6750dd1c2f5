"""``Film``: random access to the pictures of a video file, with few of them in memory.

Opening a film decodes all of it once, because damage shows nowhere else, and notes the time stamps.
The last pictures that were decoded in a row stay in memory as the decoder left them, most in half
the bytes of an RGB array. Any other is decoded on demand, from the key picture before it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.film_colors import HDR, rgb_of
from gva_mi.data.pictures import decoding, open_film, require_size, size_of, turned

KEPT = 1 << 27  # bytes of decoded pictures: 43 of 1920 x 1080 in 4:2:0


class Film(Sequence[np.ndarray]):
    """The pictures of a video file, each (H, W, 3) 8-bit, turned as its metadata say."""

    def __init__(self, path: Path, kept: int = KEPT) -> None:
        """Decode the whole film once; ``kept`` bytes of decoded pictures may stay in memory."""
        self.path = Path(path)
        self.sizes: list[tuple[int, int]] = []  # (W, H) of each picture
        self._moments: list[int | None] = []
        self._keys: list[int] = []  # numbers of the key pictures
        self._at: tuple[int, Iterator[Any], Any] | None = None  # number of the next one
        self._near, self._kept = _Near(kept), kept
        with open_film(self.path) as container:
            self._tick = float(container.streams.video[0].time_base or 0)
            self.hdr: str | None = None  # the name of its transfer of high dynamic range
            for frame in self._decoded(container):
                require_size(str(self.path), frame.width, frame.height)
                if frame.key_frame:
                    self._keys.append(len(self))
                self._near.put(len(self), frame)
                self.hdr = HDR.get(frame.color_trc, self.hdr)
                self.sizes.append(size_of(frame))
                self._moments.append(frame.pts)
        if not self.sizes:
            raise InputError(f"{path}: holds no picture")

    @property
    def times(self) -> np.ndarray | None:
        """Seconds at which the pictures are shown, (T,); None if the film does not say."""
        if self._tick == 0 or None in self._moments:
            return None
        return (np.array(self._moments, np.float64) - self._moments[0]) * self._tick

    def __len__(self) -> int:
        return len(self.sizes)

    def __getitem__(self, index: int) -> np.ndarray:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        index %= len(self)
        if index in self._near:
            return self._near.rgb(index)
        key = self._keys[max(0, bisect_right(self._keys, index) - 1)] if self._keys else 0
        if self._at is None or not key <= self._at[0] <= index:
            self._seek(index)
        number, frames, container = self._at
        for frame in frames:
            self._at = (number + 1, frames, container)
            self._near.put(number, frame)
            if number == index:
                return self._near.rgb(index)
            number += 1
        raise InputError(f"{self.path}: picture {index} was there, and cannot be decoded any more")

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the open file; another process opens its own."""
        return self.__dict__ | {"_at": None, "_near": _Near(self._kept)}

    def _seek(self, index: int) -> None:
        """Go to the key picture at or before a picture, or to the start."""
        if self._at is not None:
            self._at[2].close()
        # A decoder's memory is freed with its last picture, so drop all of the old decoder's.
        self._at, self._near = None, _Near(self._kept)
        known = {moment: k for k, moment in enumerate(self._moments)}
        moment = self._moments[index]
        if moment is not None and len(known) == len(self):
            container = open_film(self.path)
            container.seek(moment, stream=container.streams.video[0])
            frames = self._decoded(container)
            first = next(frames, None)
            number = None if first is None else known.get(first.pts)
            if number is not None and number <= index:
                self._at = (number, chain([first], frames), container)
                return
            container.close()
        container = open_film(self.path)
        self._at = (0, self._decoded(container), container)

    def _decoded(self, container: Any) -> Iterator[Any]:  # noqa: ANN401 (an import costs everybody)
        with decoding(self.path):
            yield from container.decode(video=0)


class _Near:
    """Buffer of the pictures decoded last, consecutive, in the decoder's format."""

    def __init__(self, room: int) -> None:
        """Make an empty buffer of ``room`` bytes; it keeps the last picture whatever its size."""
        self._room = room
        self._frames: dict[int, Any] = {}  # by number, in their order
        self._converter: Any = None  # one for all: each would keep tables of its own

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def put(self, number: int, frame: Any) -> None:  # noqa: ANN401 (as _decoded)
        """Add the next picture, and drop the oldest ones if there is no room."""
        self._frames[number] = frame
        self._room -= _bytes_of(frame)
        while self._room < 0 and len(self._frames) > 1:
            self._room += _bytes_of(self._frames.pop(next(iter(self._frames))))

    def rgb(self, number: int) -> np.ndarray:
        """Return a picture, (H, W, 3) 8-bit."""
        from av.video.reformatter import VideoReformatter

        if self._converter is None:
            self._converter = VideoReformatter()
        frame = self._frames[number]
        array = turned(rgb_of(frame, self._converter), frame)  # may share the frame's memory
        return array.copy() if frame.format.name == "rgb24" else array


def _bytes_of(frame: Any) -> int:  # noqa: ANN401 (as _decoded)
    return sum(plane.buffer_size for plane in frame.planes)
