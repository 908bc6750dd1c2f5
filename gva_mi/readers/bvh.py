"""Read BVH, a text format of motion capture, and find a person's joints in its skeleton.

A file is a tree of joints, and their angles frame by frame. A joint lies at its offset from its
parent, or where its position channels say, and turns by the product of its rotation channels in the
order in which the file names them, degrees. Lengths have any unit. An ``End Site`` is a point
without channels.

Programs agree on few names: ``LeftShoulder`` is a collar bone or the upper arm. They agree on what
hangs on what. So names are used for two things alone: the side of a joint (left or l, if the same
name with right or r exists), and which joints are hands, feet, head and fingers. The tree gives the
rest: a foot hangs on a shin, and a shin on a thigh; both thighs meet in the pelvis, and both arms
in the chest. The joints between are the spine, however many there are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_bytes

_CHANNEL = re.compile(r"([xyz])(position|rotation)", re.IGNORECASE)
_MOTION = re.compile(r"^\s*MOTION\s*$", re.MULTILINE | re.IGNORECASE)
_FRAMES = re.compile(r"\s*Frames\s*:\s*(\S+)\s+Frame\s+Time\s*:\s*(\S+)", re.IGNORECASE)
_EXPECTED_BVH = "a BVH file: HIERARCHY with its joints, then MOTION with a row of numbers a frame"
FINGER_WORDS = {  # finger: pattern of the words that programs name it by
    "index": "index", "middle": "middle", "pinky": "pinky|pinkie|little", "ring": "ring",
    "thumb": "thumb",
}  # fmt: skip
# Patterns of joint names: helper bones and end points, which are no joints; bones inside the palm.
_HELPER_BONE = re.compile(r"twist|roll|(^|[^a-z])ik[^a-z]|nub$|end$|top|tip$")
_PALM_BONE = re.compile(r"metacarpal|inhand|0(?=\D*$)")
# Words in the name of a limb's end, and the joints from there to the trunk.
_LIMB_CHAINS = (
    (("ankle", "foot"), ("ankle", "knee", "hip")),
    (("wrist", "hand"), ("wrist", "elbow", "shoulder")),
    (("elbow", "forearm", "lowerarm", "lowarm"), ("elbow", "shoulder")),  # where no hand is named
)
LEAST_ROTATION = 1e-3  # entry of a rotation matrix. Chosen: above the rounding of a file's digits


class Channel(NamedTuple):
    """One number of a joint in each frame."""

    axis: int  # 0, 1, 2 for x, y, z
    rotates: bool  # degrees about the axis; otherwise a length along it


class Hierarchy(NamedTuple):
    """The joints of a file, parents first; a list of the same length in each field."""

    names: list[str]  # "" of end points
    parents: list[int]  # -1 of the root
    offsets: list[list[float]]
    channels: list[list[Channel]]


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
        return bool(abs(self.rotations[frame, 1:] - np.eye(3)).max(initial=0) > LEAST_ROTATION)

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
    """Read a BVH file."""
    text = read_bytes(path, _EXPECTED_BVH).decode("utf-8-sig", errors="replace")
    head, *tail = _MOTION.split(text, maxsplit=1)
    found = _FRAMES.match(tail[0]) if tail else None
    if found is None:
        raise InputError(
            f"{path}: has no MOTION with 'Frames:' and 'Frame Time:'; expected {_EXPECTED_BVH}"
        )
    with expecting(path, _EXPECTED_BVH):
        tree = _hierarchy(path, head)
        frame_time = float(found[2])
        values = np.array(tail[0][found.end() :].split(), np.float64)
        rest = np.array(tree.offsets, np.float64)
    width = sum(map(len, tree.channels))
    if not 0 < frame_time < np.inf or not np.isfinite(rest).all():
        raise InputError(
            f"{path}: 'Frame Time' must be seconds above 0, and offsets finite; got {found[2]} and "
            f"{rest.min():g} to {rest.max():g}"
        )
    if not values.size or values.size % width:
        raise InputError(
            f"{path}: has {values.size} numbers, expected a multiple of its {width} channels; it "
            "may be cut short"
        )
    columns = values.reshape(-1, width).T
    count, columns = columns.shape[1], iter(columns)
    places = np.tile(rest, (count, 1, 1))
    turns = np.tile(np.eye(3), (count, len(tree.names), 1, 1))
    for joint, channels in enumerate(tree.channels):
        for axis, rotates in channels:
            column = next(columns)
            if rotates:
                turns[:, joint] @= to_matrices(np.radians(column)[:, None] * np.eye(3)[axis])
            else:
                places[:, joint, axis] = column
    names, parents = tuple(tree.names), np.array(tree.parents)
    return BvhClip(names, parents, rest, turns, places, frame_time, found[1])


def _hierarchy(path: Path, head: str) -> Hierarchy:
    """Parse the text before MOTION."""
    found = Hierarchy([], [], [], [])
    names, parents, offsets, channels = found
    above = [-1]  # numbers of the joints whose braces are open
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
                offsets[above[-1]] = [float(word) for word in words]
            case "CHANNELS" if above[-1] >= 0 and words and all(map(_CHANNEL.fullmatch, words[1:])):
                matches = [_CHANNEL.fullmatch(word) for word in words[1:]]
                channels[above[-1]] = [
                    Channel("xyz".index(m[1].lower()), m[2].lower() == "rotation") for m in matches
                ]
            case _:
                raise InputError(f"{path}: holds the line '{line:.40}'; expected {_EXPECTED_BVH}")
    if not any(channels) or len(above) > 1:
        raise InputError(f"{path}: has no whole skeleton; expected {_EXPECTED_BVH}")
    return found


class Between(NamedTuple):
    """A rotation between those of two joints of a skeleton."""

    first: int
    second: int
    weight: float  # of the second, in [0, 1]


@dataclass(frozen=True)
class Humanoid:
    """Which joints of a skeleton correspond to SMPL-X's."""

    joints: dict[str, Between]  # by our names
    points: dict[str, int]  # by our names, and "left_toe" and "right_toe"
    has_hands: bool


def find_humanoid(where: object, names: Sequence[str], parents: np.ndarray) -> Humanoid:
    """Find a person's joints in a skeleton; ``names`` are "" for end points."""
    tree = _NamedTree([name.lower().rsplit(":")[-1] for name in names], parents.tolist())
    points: dict[str, int] = {}
    for ends, chain in _LIMB_CHAINS:
        for side, end in zip(SIDES, tree.both(ends), strict=True):
            if f"{side}_{chain[-1]}" in points:
                continue  # the hand was found
            for name in chain:
                if end is not None:
                    points[f"{side}_{name}"] = end
                    end = tree.above(end)
            if end in tree.sided and chain[-1] == "shoulder":
                points[f"{side}_collar"] = end
    needed = [f"{side}_{name}" for name in ("hip", "knee", "ankle", "shoulder", "elbow")
              for side in SIDES]  # fmt: skip
    if not set(needed) <= set(points):
        missing = next(name for name in needed if name not in points)
        found = ", ".join(filter(None, names[:12]))
        raise InputError(
            f"{where}: its joints are named {found} ..., without a {missing.replace('_', ' ')}; "
            "expected a person with names such as Hips, LeftUpLeg, LeftLeg, LeftFoot, "
            "LeftArm, LeftForeArm, LeftHand, Head"
        )
    return _with_trunk(tree, points)


def _with_trunk(tree: _NamedTree, points: dict[str, int]) -> Humanoid:
    """Add pelvis, spine, head, toes and fingers to the limbs."""
    tops = [points.get(f"{side}_collar", points[f"{side}_shoulder"]) for side in SIDES]
    chest = tree.joining(*tops)
    points["pelvis"] = pelvis = tree.joining(points["left_hip"], points["right_hip"])
    spine = [pelvis, *(k for k in tree.to_root(chest) if k not in tree.to_root(pelvis))]
    joints = {f"spine{k + 1}": _between(spine, (k + 1) / 3) for k in range(3)}
    head = tree.first("head")
    if head is not None and pelvis in tree.to_root(head):
        points["head"] = head
        neck = [chest, *(k for k in tree.to_root(head)[:-1] if k not in tree.to_root(chest))]
        joints["neck"] = _between(neck, 1.0)
    hands = {}
    for side in SIDES:
        toes = tree.branch(points[f"{side}_ankle"])
        points |= {f"{side}_toe": toes[-1]} if toes else {}
        named = [k for k in toes if tree.names[k]]
        of_foot = [k for k in named if re.search("toe|ball", tree.names[k])] or named
        points |= {f"{side}_foot": of_foot[0]} if of_foot else {}
        hands |= _fingers(tree, side, points.get(f"{side}_wrist"))
    # A hand with one bone for all fingers does not show each of them.
    if all({f"{side}_index1", f"{side}_middle1"} & set(hands) and f"{side}_pinky1" in hands
           for side in SIDES):  # fmt: skip
        points |= hands
    else:
        hands = {}
    joints |= {name: Between(k, k, 0.0) for name, k in points.items() if name in JOINTS}
    return Humanoid(joints, points, bool(hands))


def _fingers(tree: _NamedTree, side: str, wrist: int | None) -> dict[str, int]:
    """Return the three joints of each finger, by SMPL-X's names."""
    found = {}
    on_hand = [k for k, name in enumerate(tree.names)
               if name and k != wrist and wrist in tree.to_root(k)]  # fmt: skip
    for finger, words in FINGER_WORDS.items():
        of_finger = [k for k in on_hand if re.search(words, tree.names[k])]
        if len(of_finger) > 3:
            of_finger = [k for k in of_finger if not _PALM_BONE.search(tree.names[k])
                         and re.search(r"\d", tree.names[k])]  # fmt: skip
        if len(of_finger) >= 3:
            found |= {f"{side}_{finger}{n + 1}": k for n, k in enumerate(of_finger[:3])}
    return found


def _between(chain: list[int], share: float) -> Between:
    """Return the two neighbours at a share of a chain of joints, 0 its first and 1 its last."""
    at = share * (len(chain) - 1)
    low = min(int(at + 1e-9), len(chain) - 1)
    return Between(chain[low], chain[min(low + 1, len(chain) - 1)], max(at - low, 0.0))


class _NamedTree:
    """A tree of joints, and the side of each by its name."""

    def __init__(self, names: list[str], parents: list[int]) -> None:
        self.names, self.parents = names, parents
        number = {name: k for k, name in enumerate(names) if name}
        self.opposite = {
            k: number[other]
            for name, k in number.items()
            # The name with right for left, or with each of its letters l in turn as an r.
            for other in (name.replace("left", "right"), *(
                f"{name[:at]}r{name[at + 1 :]}" for at, letter in enumerate(name) if letter == "l"))
            if other != name and other in number
        }  # fmt: skip
        self.sided = {*self.opposite, *self.opposite.values()}

    def both(self, words: Sequence[str]) -> tuple[int, int] | tuple[None, None]:
        """Return the first left joint named by any of ``words``, and its opposite on the right."""
        fit = (k for word in words for k in sorted(self.opposite) if word in self.names[k])
        found = min((k for k in fit if not _HELPER_BONE.search(self.names[k])), default=None)
        return (None, None) if found is None else (found, self.opposite[found])

    def first(self, word: str) -> int | None:
        """Return the first joint without a side that is named by a word."""
        fit = (k for k, name in enumerate(self.names) if word in name and k not in self.sided)
        return next((k for k in fit if not _HELPER_BONE.search(self.names[k])), None)

    def above(self, joint: int) -> int | None:
        """Return the next joint toward the root that is no helper bone; None if it has no side."""
        joint = self.parents[joint]
        while joint >= 0 and _HELPER_BONE.search(self.names[joint]):
            joint = self.parents[joint]
        return None if joint < 0 or joint not in self.sided else joint

    def to_root(self, joint: int) -> list[int]:
        """Return the joints from the root to ``joint``, both included."""
        path = [joint]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def joining(self, a: int, b: int) -> int:
        """Return the nearest joint from which both descend."""
        return [k for k in self.to_root(a) if k in self.to_root(b)][-1]

    def branch(self, joint: int) -> list[int]:
        """Return the chain of first children from a joint to its end, without heels."""
        found: list[int] = []
        while children := [k for k, parent in enumerate(self.parents)
                           if parent == joint and "heel" not in self.names[k]]:  # fmt: skip
            found.append(joint := children[0])
        return found
