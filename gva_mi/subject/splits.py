"""Train and test frames of a video: ``splits.json``.

::

    {"train": [...], "test": [...], "held_out_range": [...]}    frame numbers; the last is optional

A held-out range is a stretch of consecutive test frames. Poses and looks there are new, while the
neighbours of any other test frame were seen in training.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Container, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.subject.folder import SPLITS

TEST_EVERY = 8  # without splits.json, every 8th frame is a test frame
TEST_FRAMES_LIMIT = 16  # of a video, and of its held-out range. Chosen: more cost evaluation time


@dataclass(frozen=True)
class Splits:
    """Train frames, and test frames that training never uses."""

    train: list[int]
    test: list[int]
    held_out_range: list[int] = field(default_factory=list)  # part of ``test``

    @staticmethod
    def every(frames: int) -> Splits:
        """Make every 8th frame a test frame."""
        return Splits._of(frames, range(TEST_EVERY // 2, frames, TEST_EVERY))

    @staticmethod
    def one_range(frames: int) -> Splits:
        """Make an eighth of the frames, consecutive and in the middle, test frames."""
        count = max(1, frames // TEST_EVERY)
        return Splits._of(frames, range((frames - count) // 2, (frames + count) // 2))

    @staticmethod
    def of_video(frames: int) -> Splits:
        """Make every 8th frame a test frame, and a tenth of all frames a held-out range.

        A long video has fewer: at most 16 each. The range lies in the middle of the second half. A
        person who turns around once has shown this side in the first half, too.
        """
        count = min(max(1, frames // 10), TEST_FRAMES_LIMIT, frames - 1)  # a picture alone trains
        first = min(frames - count, 3 * frames // 4 - count // 2)
        held_out = range(first, first + count)
        step = max(TEST_EVERY, math.ceil(frames / TEST_FRAMES_LIMIT))
        return Splits._of(frames, {*range(step // 2, frames, step), *held_out}, held_out)

    @staticmethod
    def _of(frames: int, test: Collection[int], held_out: Iterable[int] = ()) -> Splits:
        train = [k for k in range(frames) if k not in test]
        return Splits(train, sorted(test), list(held_out))

    def to_json(self) -> dict[str, list[int]]:
        """Return the content of ``splits.json``; without the range if it is empty."""
        record = asdict(self)
        return record if self.held_out_range else {n: record[n] for n in ("train", "test")}

    def without(self, frames: Container[int]) -> Splits:
        """Return the splits without some frames."""
        keep = lambda split: [k for k in split if k not in frames]
        return Splits(keep(self.train), keep(self.test), keep(self.held_out_range))


def load_splits(folder: Path, frames: int) -> Splits:
    """Read ``splits.json``; without it, every 8th frame is a test frame."""
    path = folder / SPLITS
    if not path.exists():
        return Splits.every(frames)
    expected = '{"train": [...], "test": [...]} of frame numbers'
    data = read_json(path, expected)
    with expecting(path, expected):
        train, test = (list(data[name]) for name in ("train", "test"))
        held_out = list(data.get("held_out_range", []))
        if odd := [k for k in (*train, *test, *held_out) if type(k) is not int]:
            raise InputError(f"{path}: frames must be whole numbers, got {str(odd[0]):.40}")
    faults = {
        "frame {} does not exist": [k for k in (*train, *test) if not 0 <= k < frames],
        "frame {} of the held-out range is no test frame": sorted(set(held_out) - set(test)),
        "frame {} is in both": sorted(set(train) & set(test)),
        "frame {} is listed twice": [
            k for split in (train, test) for k, times in Counter(split).items() if times > 1],
        "there is no train frame": [] if train else [None],
    }  # fmt: skip
    for fault, wrong in faults.items():
        if wrong:
            reason = fault.format(wrong[0])
            raise InputError(f"{path}: {reason}; the video has frames 0 to {frames - 1}")
    return Splits(train, test, held_out)


def spread(indices: Iterable[int], count: int) -> list[int]:
    """Choose at most ``count`` frame numbers, evenly spaced."""
    indices = list(indices)
    chosen = np.linspace(0, len(indices) - 1, min(count, len(indices))).round().astype(int)
    return [indices[k] for k in chosen]
