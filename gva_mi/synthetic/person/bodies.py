"""Bodies that subjects are drawn on: the one below the clothes, and one of other proportions.

:class:`RestBody` is a person's body in the rest pose: joints, skin, nails, landmarks of the face.

:func:`stretched` makes a body of other proportions than the fitted one can have.
Each segment is longer or shorter, thicker or thinner. The new body keeps joints, faces and skinning
weights of the body that it is made from, but has lengths, girths, hands and feet that no betas of
that body give. With the rest joints J and one linear map A_j for all that is attached to joint j,

    1. A = t 1 + (l − t) a aᵀ                        l along the bone's direction a, t across it
    2. J'_j = J'_p + A_p (J_j − J_p)                 p the parent of j; the root stays
    3. v' = Σ_j w_j [A_j (v − J_j) + J'_j]           w the skinning weights

Equations 2 and 3 are linear in (v, J). Applied to a shape direction and its effect on the joints,
they give the shape directions of the new body, so betas keep their meaning.
:mod:`gva_mi.synthetic.errors.closest_pose` finds the poses of the fitted body that come closest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from gva_mi.body.pose import (
    JAW,
    JOINTS,
    LEFT_HAND,
    PARENTS,
    RIGHT_HAND,
    SIDES,
    WRISTS,
    Pose,
    Shape,
)
from gva_mi.body.smplx import BodyModel
from gva_mi.synthetic.person.level_sets import BodySurface, vertex_normals
from gva_mi.synthetic.person.texture import FaceLandmarks, Point

ASYMMETRY = 0.005  # difference of the factors of left and right; chosen: people are nearly alike
_FINGERS = ("index", "middle", "ring", "pinky", "thumb")
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True)
class RestBody:
    """The body of one person in the rest pose, float64."""

    vertices: np.ndarray  # (V, 3) metres
    faces: np.ndarray  # (F, 3) int64
    normals: np.ndarray  # (V, 3) unit, outwards
    joints: Mapping[str, np.ndarray]  # (3,) metres, by name
    weights: np.ndarray  # (V, 55) skinning weights
    surface: BodySurface  # measures distances from the body

    @staticmethod
    def of(body: BodyModel, shape: Shape) -> RestBody:
        """Build the rest body of a body model in one shape."""
        rest = body.rest(shape)
        vertices, faces = rest.vertices.detach().double().numpy(), body.faces.numpy()
        joints = dict(zip(JOINTS, rest.joints.detach().double().numpy(), strict=True))
        normals = vertex_normals(vertices, faces)
        weights = body.weights.detach().double().numpy()
        surface = BodySurface(vertices, faces, normals)
        return RestBody(vertices, faces, normals, joints, weights, surface)

    @property
    def between_eyes(self) -> np.ndarray:
        """The point between the eyes, (3,) metres."""
        return (self.joints["left_eye_smplhf"] + self.joints["right_eye_smplhf"]) / 2

    def skin_tint(self) -> np.ndarray:
        """Return factors (V, 3) on the skin colour: redder knuckles, paler palms."""
        tint = np.ones((len(self.vertices), 3))
        hands = self.weights[:, LEFT_HAND.start : RIGHT_HAND.stop].sum(1)
        hands = hands + self.weights[:, WRISTS[0]] + self.weights[:, WRISTS[1]]
        palm = np.clip(hands, 0, 1) * np.clip(-self.normals[:, 1], 0, 1)
        tint *= 1 + palm[:, None] * np.array([0.12, 0.10, 0.12])
        for name, joint in self.joints.items():
            if name.rstrip("123").endswith(_FINGERS):
                near = np.exp(-((self.vertices - joint) ** 2).sum(1) / (2 * 0.006**2))
                near *= np.clip(self.normals[:, 1], 0.2, 1)
                tint *= 1 - near[:, None] * np.array([0.06, 0.24, 0.24])
        return tint

    def nails(self) -> tuple[Point, ...]:
        """Return the centres of the nails, on the back of each fingertip, metres."""
        nails = []
        for finger in (f"{side}_{name}" for side in SIDES for name in _FINGERS):
            end = self.vertices[self.weights[:, JOINTS.index(f"{finger}3")] > 0.6]
            if len(end) == 0:
                continue
            along = self.joints[f"{finger}3"] - self.joints[f"{finger}2"]
            along = along / np.linalg.norm(along)
            tip = end[(end @ along).argmax()] - 0.006 * along
            near = end[np.linalg.norm(end - tip, axis=1) < 0.012]
            if len(near):
                tip[1] = near[:, 1].max()
            nails.append(tuple(tip.tolist()))
        return tuple(nails)


def face_landmarks(body: BodyModel, shape: Shape, rest: RestBody) -> FaceLandmarks:
    """Find eyes and mouth; the mouth is where the skin below the nose parts as the jaw drops.

    ``rest`` is the same body in the rest pose.
    """
    vertices = rest.vertices
    eyes = [rest.joints[f"{side}_eye_smplhf"] for side in SIDES]
    unit, middle = float(np.linalg.norm(eyes[0] - eyes[1])), rest.between_eyes
    unit = max(unit, 1e-3)  # bodies of SMPL and SMPL+H have no eyes
    x, y = np.abs(vertices[:, 0] - middle[0]), middle[1] - vertices[:, 1]
    near = vertices[(x < 0.2 * unit) & (y > 0.2 * unit) & (y < 1.1 * unit)]
    nose = near[near[:, 2].argmax()] if len(near) else middle + [0, -0.5 * unit, 0.4 * unit]
    mouth = np.array([middle[0], nose[1] - 0.44 * unit, nose[2] - 0.3 * unit])

    pose = Pose.rest(1, body.num_expressions)
    pose.rotations[:, JAW, 0] = 0.15
    dropped = (body(pose, shape).vertices[0].double().numpy() - vertices)[:, 1]
    front = (x < 0.25 * unit) & (np.abs(vertices[:, 1] - mouth[1]) < 0.4 * unit)
    front &= vertices[:, 2] > mouth[2] - 0.3 * unit
    edges = rest.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[front[edges].all(1)]
    if len(edges):
        torn = np.abs(dropped[edges[:, 0]] - dropped[edges[:, 1]])
        most = edges[torn > 0.7 * torn.max()] if torn.max() > 0.002 else edges[:0]
        if len(most):
            mouth[1:] = vertices[most].mean((0, 1))[1:]
    return FaceLandmarks(tuple(tuple(eye.tolist()) for eye in eyes), tuple(mouth.tolist()), unit)


class Segment(NamedTuple):
    """A part of the body with one stretch, whose factors lie within 1 ± spread."""

    spread: float
    axis: np.ndarray | None  # direction of the length; None: from joint to joint
    joints: tuple[str, ...]  # without the side of paired ones


SEGMENTS = (  # spreads are chosen: hands and feet differ more than limbs, heads less
    Segment(0.05, _Y, ("pelvis", "spine1", "spine2", "spine3")),  # torso
    Segment(0.05, None, ("collar",)),
    Segment(0.05, None, ("neck",)),
    Segment(0.03, _Y, ("head", "jaw", "left_eye_smplhf", "right_eye_smplhf")),
    Segment(0.05, None, ("hip",)),  # thigh
    Segment(0.05, None, ("knee",)),  # shin
    Segment(0.08, _Z, ("ankle", "foot")),
    Segment(0.05, None, ("shoulder",)),  # upper arm
    Segment(0.05, None, ("elbow",)),  # forearm
    Segment(0.08, _X, ("wrist",)),  # hand
    Segment(0.08, None, tuple(f"{f}{k}" for f in _FINGERS for k in (1, 2, 3))),
)


@dataclass(frozen=True)
class BodyStretch:
    """Factors on length and thickness, by joint name."""

    length: Mapping[str, float]
    thickness: Mapping[str, float]

    @staticmethod
    def draw(rng: Generator) -> BodyStretch:
        """Draw proportions, left and right nearly alike."""
        length, thickness = {}, {}
        for spread, _, joints in SEGMENTS:
            both, sides = spread * rng.uniform(-1, 1, 2), _sides(joints)
            for names in sides:
                apart = rng.uniform(-1, 1, 2) * (ASYMMETRY if len(sides) == 2 else 0.0)
                for joint in names:
                    length[joint], thickness[joint] = (1 + (both + apart)).tolist()
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


def _sides(joints: tuple[str, ...]) -> list[list[str]]:
    """Return the joints of a segment on each side, or once if it lies in the middle."""
    if joints[0] in JOINTS:
        return [list(joints)]
    return [[f"{side}_{name}" for name in joints] for side in SIDES]


def _maps(joints: np.ndarray, stretch: BodyStretch) -> np.ndarray:
    """Return A of eq. 1, (55, 3, 3), for rest joints (55, 3)."""
    maps = np.zeros((len(JOINTS), 3, 3))
    for _, axis, names in SEGMENTS:
        for joint in chain(*_sides(names)):
            a = _bone(joints, joint) if axis is None else axis
            length, thickness = stretch.length[joint], stretch.thickness[joint]
            along = (length - thickness) * np.outer(a, a)
            maps[JOINTS.index(joint)] = thickness * np.eye(3) + along
    return maps


def _bone(joints: np.ndarray, joint: str) -> np.ndarray:
    """Return the unit direction of the bone at a joint; at a fingertip, of the bone before it."""
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
