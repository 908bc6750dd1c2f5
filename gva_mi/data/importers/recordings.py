"""``Recording``: what ``prepare`` makes a folder of: people, pictures, masks, and a split.

An estimator's file gives the people alone, a data set all of it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gva_mi.data.importers.tracks import Track
from gva_mi.data.video import Splits
from gva_mi.errors import InputError

Pictures = Path | tuple[Path, ...]  # a film or a folder, or single files in order


@dataclass(frozen=True)
class Wanted:
    """What of a data set is asked for."""

    camera: str | None = None  # the name of the one that becomes the video; None: the first
    components: np.ndarray | None = None  # (2, K, 45) of the body file's PCA of hands


@dataclass(frozen=True)
class OtherCamera:
    """One of a data set's cameras: x_cam = R x + T."""

    frames: Mapping[int, Path]  # pictures, by the data set's numbers
    masks: Mapping[int, Path]  # those that are there, likewise
    K: np.ndarray  # (3, 3) pixels
    R: np.ndarray  # (3, 3)
    T: np.ndarray  # (3,) metres
    distortion: np.ndarray  # (k1, k2, p1, p2, k3); zeros: a pinhole


@dataclass(frozen=True)
class Recording:
    """People, and the pictures they are seen in."""

    tracks: list[Track]
    frames: Pictures
    masks: Pictures | None  # None: the source has none
    distortion: np.ndarray | None = None  # (k1, k2, p1, p2, k3) of the lens; None: a pinhole
    labels: bool = False  # masks number parts of the person: whatever is not zero is inside
    around: bool = False  # masks are 255 around the person, and zero inside
    splits: Splits | None = None  # of the data set's own protocol
    loose: bool = False  # pictures, masks and poses may be of different number; the fewest count
    note: str = ""  # what to say about it
    own: OtherCamera | None = None  # the video's, where there are others
    others: Mapping[str, Callable[[], OtherCamera]] = field(default_factory=dict)  # by name
    numbers: Sequence[int] = ()  # the data set's, of the video's frames; where there are others


def read_ranges(path: Path, frames: int) -> Splits:
    """A protocol's train and test frames, of a file like InstantAvatar's, by first, last and step.

    ::

        train:
          start: 0
          end: 455
          skip: 4
        test:
          start: 456
          ...

    The last frame is among them, or where the video ends; what else such a file says is passed
    over.

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
        found = (
            dict(re.findall(r"^[ \t]*(start|end|skip):[ \t]*(\d+)[ \t]*$", part[2], re.M))
            if part
            else {}
        )
        if not {"start", "end"} <= set(found):
            raise InputError(f"{path}: {name} must have start and end, whole numbers of frames")
        step = int(found.get("skip", 1))
        start, end = int(found["start"]), min(int(found["end"]), frames - 1)
        if not (step > 0 and start <= end):
            raise InputError(
                f"{path}: {name} is {start} to {found['end']} in steps of {step}, but the video "
                f"has frames 0 to {frames - 1}"
            )
        chosen[name] = list(range(start, end + 1, step))
    if both := set(chosen["train"]) & set(chosen["test"]):
        raise InputError(f"{path}: frame {min(both)} is both train and test")
    return Splits(chosen["train"], chosen["test"])
