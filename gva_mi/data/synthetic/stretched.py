"""Another person's proportions: each segment of a body longer or shorter, thicker or thinner.

No shape space spans all people. A stretched body has the joints, the faces and the weights of the
body that it is made from, but lengths, girths, hands and feet that no betas of that body give. With
the rest joints J, and one linear map A_j for what hangs on joint j,

    1. A = t 1 + (l − t) a aᵀ                        l along the bone's direction a, t across it
    2. J'_j = J'_p + A_p (J_j − J_p)                 p the parent of j; the root stays
    3. v' = Σ_j w_j [A_j (v − J_j) + J'_j]           w the skinning weights

It is skinning with maps that stretch, so that surface and joints move together and smoothly. Both
are linear in (v, J). So the same sums, taken of a direction of the shape and what it does to the
joints, are the directions of the new body: its betas mean what they meant, on other proportions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.body.smplx import BodyModel

SIDES = ("left", "right")
ASYMMETRY = 0.005  # by how much left and right differ, as a factor
_FINGERS = ("index", "middle", "ring", "pinky", "thumb")


@dataclass(frozen=True)
class Segment:
    """A part of the body that is stretched as one."""

    joints: tuple[str, ...]  # without their side, where the segment has one
    spread: float  # at strength 1, its factors lie within 1 ± spread
    axis: tuple[float, float, float] | None  # of its length; None: from each joint to the next
    paired: bool = True  # one on each side


_Y, _Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SEGMENTS: Mapping[str, Segment] = {
    "torso": Segment(("pelvis", "spine1", "spine2", "spine3"), 0.05, _Y, paired=False),
    "shoulder": Segment(("collar",), 0.05, None),
    "neck": Segment(("neck",), 0.05, None, paired=False),
    "head": Segment(("head", "jaw", "left_eye_smplhf", "right_eye_smplhf"), 0.03, _Y, paired=False),
    "thigh": Segment(("hip",), 0.05, None),
    "shin": Segment(("knee",), 0.05, None),
    "foot": Segment(("ankle", "foot"), 0.08, _Z),
    "upper arm": Segment(("shoulder",), 0.05, None),
    "forearm": Segment(("elbow",), 0.05, None),
    "hand": Segment(("wrist",), 0.08, (1.0, 0.0, 0.0)),
    "fingers": Segment(tuple(f"{f}{k}" for f in _FINGERS for k in (1, 2, 3)), 0.08, None),
}
_NEXT = {"hip": "knee", "knee": "ankle", "collar": "shoulder", "shoulder": "elbow",
         "elbow": "wrist", "neck": "head"}  # fmt: skip


@dataclass(frozen=True)
class Stretch:
    """A factor on the length and one on the thickness of every joint's segment."""

    length: Mapping[str, float]  # by the joint's name
    thickness: Mapping[str, float]

    @staticmethod
    def draw(rng: np.random.Generator, strength: float = 1.0) -> Stretch:
        """Random proportions, left and right nearly alike; strength 0 changes nothing."""
        length, thickness = {}, {}
        for segment in SEGMENTS.values():
            both = segment.spread * rng.uniform(-1, 1, 2)
            for side in SIDES if segment.paired else ("",):
                own = rng.uniform(-1, 1, 2) * (ASYMMETRY if side else 0.0)
                for name in segment.joints:
                    joint = f"{side}_{name}" if side else name
                    length[joint], thickness[joint] = (1 + strength * (both + own)).tolist()
        return Stretch(length, thickness)


def stretched(body: BodyModel, stretch: Stretch) -> BodyModel:
    """A body with other proportions, with ten betas and ten expressions at most.

    Args:
        body: whole, not a part of one.
        stretch: of each segment.
    """
    arrays = {name: np.asarray(array) for name, array in body.arrays().items()}
    weights = arrays["weights"].astype(np.float64)
    regressor = arrays["J_regressor"].astype(np.float64)
    template = arrays["v_template"].astype(np.float64)
    maps = _maps(regressor @ template, stretch)
    moved = lambda vertices, joints: _stretched(vertices, joints, maps, weights)
    of_shape = [
        moved(direction, regressor @ direction)
        for direction in arrays["shapedirs"].astype(np.float64).transpose(2, 0, 1)
    ]
    A = np.einsum("vj,jab->vab", weights, maps)
    dtype = body.v_template.dtype
    return BodyModel(
        arrays
        | {
            "v_template": moved(template, regressor @ template),
            "shapedirs": np.stack(of_shape, axis=2),
            "posedirs": np.einsum("vab,vbk->vak", A, arrays["posedirs"]),
        },
        dtype,
    )


def _maps(joints: np.ndarray, stretch: Stretch) -> np.ndarray:
    """A of eq. 1, (55, 3, 3), for the rest joints (55, 3)."""
    maps = np.zeros((len(JOINTS), 3, 3))
    for segment in SEGMENTS.values():
        for side in SIDES if segment.paired else ("",):
            for name in segment.joints:
                joint = f"{side}_{name}" if side else name
                a = np.array(segment.axis or _bone(joints, joint, side, name))
                length, thickness = stretch.length[joint], stretch.thickness[joint]
                along = (length - thickness) * np.outer(a, a)
                maps[JOINTS.index(joint)] = thickness * np.eye(3) + along
    return maps


def _bone(joints: np.ndarray, joint: str, side: str, name: str) -> np.ndarray:
    """The unit direction of the bone that begins at a joint; a finger's last one goes straight."""
    begin = JOINTS.index(joint)
    if name.endswith("3"):
        begin, end = PARENTS[begin], begin
    elif name in _NEXT:
        end = JOINTS.index(f"{side}_{_NEXT[name]}" if side else _NEXT[name])
    else:
        end = begin + 1  # the next joint of the same finger
    along = joints[end] - joints[begin]
    return along / np.linalg.norm(along)


def _stretched(
    vertices: np.ndarray, joints: np.ndarray, maps: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """v' of eq. 3, (V, 3), for vertices (V, 3) and joints (55, 3), or for directions of both."""
    moved = joints.copy()
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            moved[joint] = moved[parent] + maps[parent] @ (joints[joint] - joints[parent])
    constant = moved - np.einsum("jab,jb->ja", maps, joints)
    return np.einsum("vj,jab,vb->va", weights, maps, vertices, optimize=True) + weights @ constant
