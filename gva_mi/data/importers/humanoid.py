"""Find a person's joints in a skeleton of any program, by the names and the tree of its joints.

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

import numpy as np

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.core.errors import InputError

FINGERS = {"index": "index", "middle": "middle", "pinky": "pinky|pinkie|little", "ring": "ring",
           "thumb": "thumb"}  # fmt: skip
_NO_JOINT = re.compile(r"twist|roll|(^|[^a-z])ik[^a-z]|nub$|end$|top|tip$")
_PALM = re.compile(r"metacarpal|inhand|0(?=\D*$)")  # names of bones inside the palm


_CHAINS = (  # words in the name of a limb's end, and what follows from it to the trunk
    (("ankle", "foot"), ("ankle", "knee", "hip")),
    (("wrist", "hand"), ("wrist", "elbow", "shoulder")),
    (("elbow", "forearm", "lowerarm", "lowarm"), ("elbow", "shoulder")),  # where no hand is named
)


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
    for ends, chain in _CHAINS:
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
    for finger, words in FINGERS.items():
        of_finger = [k for k in on_hand if re.search(words, tree.names[k])]
        if len(of_finger) > 3:
            of_finger = [k for k in of_finger if not _PALM.search(tree.names[k])
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
        found = min((k for k in fit if not _NO_JOINT.search(self.names[k])), default=None)
        return (None, None) if found is None else (found, self.twin[found])

    def first(self, word: str) -> int | None:
        """Return the first joint without a side that is named by a word."""
        fit = (k for k, name in enumerate(self.names) if word in name and k not in self.sided)
        return next((k for k in fit if not _NO_JOINT.search(self.names[k])), None)

    def above(self, joint: int) -> int | None:
        """Return the next joint toward the root that is no helper of a twist."""
        joint = self.parents[joint]
        while joint >= 0 and _NO_JOINT.search(self.names[joint]):
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
