"""The body below the clothes, in its rest pose: joints, skin, nails, and landmarks of the face."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JAW, JOINTS, LEFT_HAND, RIGHT_HAND, SIDES, WRISTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.synthetic.person.level_sets import BodySurface, vertex_normals
from gva_mi.synthetic.person.texture import FaceLandmarks, Point

_FINGERS = ("index", "middle", "ring", "pinky", "thumb")


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
