"""Read BVH, the text form of motion capture: a tree of joints, and their angles frame by frame.

A joint lies at its offset from its parent, or where its position channels say, and turns by the
product of its rotation channels in the order in which the file names them, degrees. Lengths have
any unit. An ``End Site`` is a point without channels.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_bytes

_CHANNEL = re.compile(r"([xyz])(position|rotation)", re.IGNORECASE)
_MOTION = re.compile(r"^\s*MOTION\s*$", re.MULTILINE | re.IGNORECASE)
_FRAMES = re.compile(r"\s*Frames\s*:\s*(\S+)\s+Frame\s+Time\s*:\s*(\S+)", re.IGNORECASE)
_EXPECTED = "a BVH file: HIERARCHY with its joints, then MOTION with a row of numbers a frame"


@dataclass(frozen=True)
class BvhClip:
    """A skeleton of J joints and end points, and T frames of it."""

    names: tuple[str, ...]  # J; "" of end points
    parents: np.ndarray  # (J,), -1 of the root, parents first
    offsets: np.ndarray  # (J, 3) from the parent, where the joint has no position of its own
    rotations: np.ndarray  # (T, J, 3, 3) relative to the parent
    places: np.ndarray  # (T, J, 3) relative to the parent
    frame_time: float  # seconds
    announced: str  # the number of frames that the file says

    def __len__(self) -> int:
        return len(self.rotations)

    def turns_in(self, frame: int) -> bool:
        """Return whether any joint but the root turns in a frame."""
        return bool(abs(self.rotations[frame, 1:] - np.eye(3)).max(initial=0) > 1e-3)

    def in_world(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (T, J, 3, 3) and places (T, J, 3) of all joints in the world."""
        turns, places = self.rotations.copy(), self.places.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                turned = np.einsum("tab,tb->ta", turns[:, parent], self.places[:, joint])
                places[:, joint] = places[:, parent] + turned
                turns[:, joint] = turns[:, parent] @ self.rotations[:, joint]
        return turns, places


def read_bvh(path: Path) -> BvhClip:
    """Read a file."""
    text = read_bytes(path, _EXPECTED).decode("utf-8-sig", errors="replace")
    head, *tail = _MOTION.split(text, maxsplit=1)
    names, parents, offsets, channels = _hierarchy(path, head)
    found = _FRAMES.match(tail[0]) if tail else None
    if found is None:
        raise InputError(
            f"{path}: has no MOTION with 'Frames:' and 'Frame Time:'; expected {_EXPECTED}"
        )
    try:
        frame_time = float(found[2])
        values = np.array(tail[0][found.end() :].split(), np.float64)
    except ValueError as error:
        raise InputError(
            f"{path}: holds a word among the numbers of its frames ({error})"
        ) from None
    width = sum(map(len, channels))
    if not 0 < frame_time < np.inf:
        raise InputError(f"{path}: 'Frame Time' must be seconds above 0, got {found[2]}")
    if not values.size or values.size % width:
        raise InputError(
            f"{path}: has {values.size} numbers, expected a multiple of its {width} channels; it "
            "may be cut short"
        )
    rest, columns = np.array(offsets), values.reshape(-1, width).T
    count, columns = columns.shape[1], iter(columns)
    places = np.tile(rest, (count, 1, 1))
    turns = np.tile(np.eye(3), (count, len(names), 1, 1))
    for joint, of_joint in enumerate(channels):
        for axis, turning in of_joint:
            column = next(columns)
            if turning:
                turns[:, joint] @= to_matrices(np.radians(column)[:, None] * np.eye(3)[axis])
            else:
                places[:, joint, axis] = column
    return BvhClip(tuple(names), np.array(parents), rest, turns, places, frame_time, found[1])


def _hierarchy(
    path: Path, head: str
) -> tuple[list[str], list[int], list[list[float]], list[list[tuple[int, bool]]]]:
    """Return names, parents, offsets and channels (axis, whether it turns) of the joints."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[list[tuple[int, bool]]] = []
    above = [-1]
    for line in re.sub(r"([{}])", r"\n\1\n", head).splitlines():
        key, *words = line.split() or [""]
        match key.upper():
            case "" | "HIERARCHY":
                continue
            case "ROOT" if names:
                raise InputError(f"{path}: holds several skeletons; expected one in a file")
            case "ROOT" | "JOINT" | "END":
                names.append("" if key.upper() == "END" else " ".join(words))
                parents.append(above[-1])
                offsets.append([0.0] * 3)
                channels.append([])
            case "{":
                above.append(len(names) - 1)
            case "}" if len(above) > 1:
                above.pop()
            case "OFFSET" if above[-1] >= 0 and len(words) == 3:
                offsets[above[-1]] = [_number(path, word) for word in words]
            case "CHANNELS" if above[-1] >= 0 and words:
                matches = [_CHANNEL.fullmatch(word) for word in words[1:]]
                if None in matches or words[0] != str(len(matches)):
                    raise InputError(
                        f"{path}: has the channels '{' '.join(words)}' at {names[above[-1]]}; "
                        "expected their number, then names such as Xposition and Zrotation"
                    )
                of_joint = [("xyz".index(m[1].lower()), m[2].lower() == "rotation")
                            for m in matches]  # fmt: skip
                channels[above[-1]] = of_joint
            case _:
                raise InputError(f"{path}: holds the line '{line:.40}'; expected {_EXPECTED}")
    if not any(channels) or len(above) > 1:
        raise InputError(f"{path}: has no whole skeleton; expected {_EXPECTED}")
    return names, parents, offsets, channels


def _number(path: Path, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not abs(value) < np.inf:
        raise InputError(f"{path}: holds the offset '{word}'; expected finite numbers")
    return value
