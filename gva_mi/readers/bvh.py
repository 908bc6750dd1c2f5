"""Read BVH, the text form of motion capture, and find a person's joints in its skeleton.

A file is a tree of joints, and their angles frame by frame. A joint lies at its offset from its
parent, or where its position channels say, and turns by the product of its rotation channels in the
order in which the file names them, degrees. Lengths have any unit. An ``End Site`` is a point
without channels.

Programs agree on few names: ``LeftShoulder`` is a collar bone or the upper arm. They agree on what
hangs on what. So names only say which side a joint is of (a name with left or l whose twin with
right or r exists), and where hands, feet, head and fingers are. The tree says the rest: a foot
hangs on a shin, and a shin on a thigh; what joins both thighs is the pelvis, and what joins both
arms is the chest. The joints between are the spine, however many there are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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
_HELPER_BONE = re.compile(r"twist|roll|(^|[^a-z])ik[^a-z]|nub$|end$|top|tip$")
_PALM_BONE = re.compile(r"metacarpal|inhand|0(?=\D*$)")  # names of bones inside the palm
_LIMB_CHAINS = (  # words in the name of a limb's end, and what follows from it to the trunk
    (("ankle", "foot"), ("ankle", "knee", "hip")),
    (("wrist", "hand"), ("wrist", "elbow", "shoulder")),
    (("elbow", "forearm", "lowerarm", "lowarm"), ("elbow", "shoulder")),  # where no hand is named
)
Channels = list[tuple[int, bool]]  # axis, and whether the joint turns about it or moves along it


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
    text = read_bytes(path, _EXPECTED_BVH).decode("utf-8-sig", errors="replace")
    head, *tail = _MOTION.split(text, maxsplit=1)
    found = _FRAMES.match(tail[0]) if tail else None
    if found is None:
        raise InputError(
            f"{path}: has no MOTION with 'Frames:' and 'Frame Time:'; expected {_EXPECTED_BVH}"
        )
    with expecting(path, _EXPECTED_BVH):
        names, parents, offsets, channels = _hierarchy(path, head)
        frame_time = float(found[2])
        values = np.array(tail[0][found.end() :].split(), np.float64)
        rest = np.array(offsets, np.float64)
    width = sum(map(len, channels))
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
) -> tuple[list[str], list[int], list[list[float]], list[Channels]]:
    """Return names, parents, offsets and channels of the joints."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[Channels] = []
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
                offsets[above[-1]] = [float(word) for word in words]
            case "CHANNELS" if above[-1] >= 0 and words and all(map(_CHANNEL.fullmatch, words[1:])):
                matches = [_CHANNEL.fullmatch(word) for word in words[1:]]
                channels[above[-1]] = [
                    ("xyz".index(m[1].lower()), m[2].lower() == "rotation") for m in matches
                ]
            case _:
                raise InputError(f"{path}: holds the line '{line:.40}'; expected {_EXPECTED_BVH}")
    if not any(channels) or len(above) > 1:
        raise InputError(f"{path}: has no whole skeleton; expected {_EXPECTED_BVH}")
    return names, parents, offsets, channels


@dataclass(frozen=True)
class Humanoid:
    """Which joints of a skeleton are which of SMPL-X's."""

    # Our joint: two joints of the skeleton, and how far from the first to the second it turns.
    joints: dict[str, tuple[int, int, float]]
    points: dict[str, int]  # of the skeleton, by our names, and the "left_toe" and "right_toe"
    has_hands: bool


def find_humanoid(where: object, names: Sequence[str], parents: np.ndarray) -> Humanoid:
    """Find a person's joints; ``names`` are "" for points that are no joints."""
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
            f"{where}: its joints are named {found} ..., and no {missing.replace('_', ' ')} is "
            "among them; expected a person with names such as Hips, LeftUpLeg, LeftLeg, LeftFoot, "
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
    # Hands with one bone for all fingers say nothing of the single ones.
    if all({f"{side}_index1", f"{side}_middle1"} & set(hands) and f"{side}_pinky1" in hands
           for side in SIDES):  # fmt: skip
        points |= hands
    else:
        hands = {}
    joints |= {name: (k, k, 0.0) for name, k in points.items() if name in JOINTS}
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


def _between(chain: list[int], share: float) -> tuple[int, int, float]:
    """Return the place at a share of a chain as two neighbours and a weight of the second."""
    at = share * (len(chain) - 1)
    low = min(int(at + 1e-9), len(chain) - 1)
    return chain[low], chain[min(low + 1, len(chain) - 1)], max(at - low, 0.0)


class _NamedTree:
    """A tree of joints, and the side of each by its name."""

    def __init__(self, names: list[str], parents: list[int]) -> None:
        self.names, self.parents = names, parents
        number = {name: k for k, name in enumerate(names) if name}
        self.twin = {
            k: number[other]
            for name, k in number.items()
            # The name with right for left, or with each of its letters l in turn as an r.
            for other in (name.replace("left", "right"), *(
                f"{name[:at]}r{name[at + 1 :]}" for at, letter in enumerate(name) if letter == "l"))
            if other != name and other in number
        }  # fmt: skip
        self.sided = {*self.twin, *self.twin.values()}

    def both(self, words: Sequence[str]) -> tuple[int, int] | tuple[None, None]:
        """Return the first left joint named by any of ``words``, and its twin on the right."""
        fit = (k for word in words for k in sorted(self.twin) if word in self.names[k])
        found = min((k for k in fit if not _HELPER_BONE.search(self.names[k])), default=None)
        return (None, None) if found is None else (found, self.twin[found])

    def first(self, word: str) -> int | None:
        """Return the first joint without a side that is named by a word."""
        fit = (k for k, name in enumerate(self.names) if word in name and k not in self.sided)
        return next((k for k in fit if not _HELPER_BONE.search(self.names[k])), None)

    def above(self, joint: int) -> int | None:
        """Return the next joint toward the root that is no helper of a twist."""
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
        """Return the nearest joint on which both hang."""
        return [k for k in self.to_root(a) if k in self.to_root(b)][-1]

    def branch(self, joint: int) -> list[int]:
        """Return what follows a joint up to an end: the first child each time, but no heel."""
        found: list[int] = []
        while children := [k for k, parent in enumerate(self.parents)
                           if parent == joint and "heel" not in self.names[k]]:  # fmt: skip
            found.append(joint := children[0])
        return found
