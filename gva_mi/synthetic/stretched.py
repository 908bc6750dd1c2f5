"""Bodies of other proportions: each segment longer or shorter, thicker or thinner.

No shape space spans all people. A stretched body keeps joints, faces and skinning weights of the
body that it is made from, but has lengths, girths, hands and feet that no betas of that body give.
With the rest joints J and one linear map A_j for all that is attached to joint j,

    1. A = t 1 + (l − t) a aᵀ                        l along the bone's direction a, t across it
    2. J'_j = J'_p + A_p (J_j − J_p)                 p the parent of j; the root stays
    3. v' = Σ_j w_j [A_j (v − J_j) + J'_j]           w the skinning weights

Equations 2 and 3 are linear in (v, J). Applied to a shape direction and its effect on the joints,
they give the shape directions of the new body, so betas keep their meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.body.smplx import BodyModel

ASYMMETRY = 0.005  # difference of the factors of left and right
_FINGERS = ("index", "middle", "ring", "pinky", "thumb")


@dataclass(frozen=True)
class BodySegment:
    """A part of the body with one stretch."""

    joints: tuple[str, ...]  # without their side if the segment is paired
    spread: float  # at strength 1, factors lie within 1 ± spread
    axis: tuple[float, float, float] | None  # direction of its length; None: joint to joint
    paired: bool = True  # one on each side

    @property
    def names(self) -> list[list[str]]:
        """Names of its joints, on each side."""
        if not self.paired:
            return [list(self.joints)]
        return [[f"{side}_{name}" for name in self.joints] for side in ("left", "right")]


_Y, _Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SEGMENTS: Mapping[str, BodySegment] = {
    "torso": BodySegment(("pelvis", "spine1", "spine2", "spine3"), 0.05, _Y, paired=False),
    "shoulder": BodySegment(("collar",), 0.05, None),
    "neck": BodySegment(("neck",), 0.05, None, paired=False),
    "head": BodySegment(
        ("head", "jaw", "left_eye_smplhf", "right_eye_smplhf"), 0.03, _Y, paired=False
    ),
    "thigh": BodySegment(("hip",), 0.05, None),
    "shin": BodySegment(("knee",), 0.05, None),
    "foot": BodySegment(("ankle", "foot"), 0.08, _Z),
    "upper arm": BodySegment(("shoulder",), 0.05, None),
    "forearm": BodySegment(("elbow",), 0.05, None),
    "hand": BodySegment(("wrist",), 0.08, (1.0, 0.0, 0.0)),
    "fingers": BodySegment(tuple(f"{f}{k}" for f in _FINGERS for k in (1, 2, 3)), 0.08, None),
}


@dataclass(frozen=True)
class BodyStretch:
    """Factors on length and thickness, by joint name."""

    length: Mapping[str, float]
    thickness: Mapping[str, float]

    @staticmethod
    def draw(rng: np.random.Generator, strength: float = 1.0) -> BodyStretch:
        """Draw proportions, left and right nearly alike; strength 0 changes nothing."""
        length, thickness = {}, {}
        for segment in SEGMENTS.values():
            both = segment.spread * rng.uniform(-1, 1, 2)
            for names in segment.names:
                own = rng.uniform(-1, 1, 2) * (ASYMMETRY if segment.paired else 0.0)
                for joint in names:
                    length[joint], thickness[joint] = (1 + strength * (both + own)).tolist()
        return BodyStretch(length, thickness)


def stretched(body: BodyModel, stretch: BodyStretch) -> BodyModel:
    """Stretch a whole body; the result has at most ten betas and ten expressions."""
    arrays = {name: np.asarray(array) for name, array in body.arrays().items()}
    weights = arrays["weights"].astype(np.float64)
    regressor = arrays["J_regressor"].astype(np.float64)
    template = arrays["v_template"].astype(np.float64)
    maps = _maps(regressor @ template, stretch)
    moved = lambda vertices: _stretched(vertices, regressor @ vertices, maps, weights)
    of_shape = [moved(d) for d in arrays["shapedirs"].astype(np.float64).transpose(2, 0, 1)]
    A = np.einsum("vj,jab->vab", weights, maps)
    changed = {
        "v_template": moved(template),
        "shapedirs": np.stack(of_shape, axis=2),
        "posedirs": np.einsum("vab,vbk->vak", A, arrays["posedirs"]),
    }
    return BodyModel(arrays | changed, body.v_template.dtype)


def _maps(joints: np.ndarray, stretch: BodyStretch) -> np.ndarray:
    """Return A of eq. 1, (55, 3, 3), for rest joints (55, 3)."""
    maps = np.zeros((len(JOINTS), 3, 3))
    for segment in SEGMENTS.values():
        for joint in chain(*segment.names):
            a = np.array(segment.axis or _bone(joints, joint))
            length, thickness = stretch.length[joint], stretch.thickness[joint]
            along = (length - thickness) * np.outer(a, a)
            maps[JOINTS.index(joint)] = thickness * np.eye(3) + along
    return maps


def _bone(joints: np.ndarray, joint: str) -> np.ndarray:
    """Return the unit direction of the bone at a joint; at a fingertip, that of the bone before."""
    end = JOINTS.index(joint)
    begin = PARENTS[end]
    if end in PARENTS:  # it has a child
        begin, end = end, PARENTS.index(end)
    along = joints[end] - joints[begin]
    return along / np.linalg.norm(along)


def _stretched(
    vertices: np.ndarray, joints: np.ndarray, maps: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return v' of eq. 3, (V, 3), for vertices (V, 3) and joints (55, 3) or directions of both."""
    moved = joints.copy()
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            moved[joint] = moved[parent] + maps[parent] @ (joints[joint] - joints[parent])
    constant = moved - np.einsum("jab,jb->ja", maps, joints)
    return np.einsum("vj,jab,vb->va", weights, maps, vertices, optimize=True) + weights @ constant
