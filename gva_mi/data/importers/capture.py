"""``Capture``: people with the pictures and masks that they are seen in, and a split.

An estimator's file gives the people alone, a data set all of it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.importers.footage import Pictures, masks
from gva_mi.data.importers.tracks import Track
from gva_mi.data.video import Splits


@dataclass(frozen=True)
class FixedCamera:
    """One of a data set's cameras: x_cam = R x + T."""

    frames: Mapping[int, Path]  # pictures, by the data set's numbers
    masks: Mapping[int, Path]  # those that are there, likewise
    K: np.ndarray  # (3, 3) pixels
    R: np.ndarray  # (3, 3)
    T: np.ndarray  # (3,) metres
    distortion: np.ndarray  # (k1, k2, p1, p2, k3); zeros: a pinhole

    @staticmethod
    def of_opencv(
        frames: Mapping[int, Path],
        masks: Mapping[int, Path],
        K: object,
        R: object,
        T: object,
        distortion: object,
    ) -> FixedCamera:
        """A camera by OpenCV, where the centre of the first pixel is at 0 and not at 0.5."""
        flat = lambda x: np.ravel(np.asarray(x, np.float64))
        half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        K, R = flat(K).reshape(3, 3) + half, flat(R).reshape(3, 3)
        return FixedCamera(frames, masks, K, R, flat(T), flat(distortion))


@dataclass(frozen=True)
class Capture:
    """People, and the pictures they are seen in."""

    tracks: list[Track]
    frames: Pictures
    masks: Pictures | None  # None: the source has none
    distortion: np.ndarray | None = None  # (k1, k2, p1, p2, k3) of the lens; None: a pinhole
    labels: bool = False  # masks number parts of the person: whatever is not zero is inside
    splits: Splits | None = None  # of the data set's own protocol
    loose: bool = False  # pictures, masks and poses may differ in number; the fewest count
    note: str = ""
    own: FixedCamera | None = None  # the video's, where there are others
    others: Mapping[str, Callable[[], FixedCamera]] = field(default_factory=dict)  # by name
    numbers: Sequence[int] = ()  # the data set's, of the video's frames; where there are others

    def read_masks(self, source: Pictures | None = None) -> Iterator[np.ndarray]:
        """The masks, or those of another source: 255 inside, whatever the data set's numbers."""
        for mask in masks(source or self.masks):
            yield (mask > 0) * np.uint8(255) if self.labels else mask


def read_ranges(path: Path, frames: int) -> Splits:
    """Read a protocol's train and test frames, by first, last and step, as InstantAvatar has them.

    ::

        train:
          start: 0
          end: 455
          skip: 4
        test:
          start: 456
          ...

    The last frame is included, or the video's last one; what else the file says does not count.

    Raises:
        InputError: no such file, no such numbers, or frames that the video does not have.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{path}: not a readable file of train: and test: ranges") from None
    chosen = {}
    for name in ("train", "test"):
        part = re.search(rf"^([ \t]*){name}:[ \t]*\n((?:\1[ \t]+.*\n?|[ \t]*\n)+)", text, re.M)
        pairs = re.findall(r"^[ \t]*(start|end|skip):[ \t]*(\d+)[ \t]*$", part[2] if part else "",
                           re.M)  # fmt: skip
        found = {key: int(number) for key, number in pairs}
        if not {"start", "end"} <= set(found):
            raise InputError(f"{path}: {name} must have start and end, whole numbers of frames")
        start, step = found["start"], found.get("skip", 1)
        end = min(found["end"], frames - 1)
        if not (step > 0 and start <= end):
            raise InputError(
                f"{path}: {name} is {start} to {found['end']} in steps of {step}, but the video "
                f"has frames 0 to {frames - 1}"
            )
        chosen[name] = list(range(start, end + 1, step))
    if both := set(chosen["train"]) & set(chosen["test"]):
        raise InputError(f"{path}: frame {min(both)} is both train and test")
    return Splits(chosen["train"], chosen["test"])
