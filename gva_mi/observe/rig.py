"""Where the landmarks of a network sit on the body.

A landmark moves rigidly with one joint. Its rest point ``x_p(β)`` is a joint or a vertex of the
body, which is linear in the shape. With the transform of its joint, landmark ``p`` is at

1. ``y_p = T_world_rest[joint(p)] (x_p(β) + o_p)``.

Annotators mark a hip, a shoulder or a knuckle a few centimetres off the joint of a body model. The
offset ``o_p`` is that difference: constant in a video, with the standard deviation
``offset_spread_p``. Its mean is part of ``x_p``, and belongs to one network. Keypoints of OpenPose
and the like are taken as joints, as fits of body models do (Pavlakos et al., SMPLify-X, 2019;
Kolotouros et al., SPIN, 2019). These fits ignore their hips, which lie elsewhere than a body
model's; here their offset is nearly free.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.smplx import BodyModel, columns_of
from gva_mi.core.errors import InputError
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks, hand_names

# Landmarks that are joints: the joint, and the standard deviation of the offset, metres, chosen by
# eye. A name without a side stands for both.
_JOINTS = {
    "shoulder": ("shoulder", 0.020), "elbow": ("elbow", 0.015), "wrist": ("wrist", 0.012),
    "hip": ("hip", 0.020), "knee": ("knee", 0.015), "ankle": ("ankle", 0.012),
    "pinky": ("pinky1", 0.012), "index": ("index1", 0.012), "thumb": ("thumb2", 0.012),
    "hand_wrist": ("wrist", 0.015),
}  # fmt: skip
# What annotators mark, relative to these joints and to the points of feet below: metres outward
# from the body's middle, upward and forward in the T-pose. Means of BlazePose's answers.
_MARKED = {
    "shoulder": (-0.022, 0.025, 0.0), "elbow": (-0.006, 0.0, 0.010), "hip": (0.018, -0.003, 0.0),
    "knee": (0.0, 0.007, 0.0), "ankle": (-0.005, 0.011, 0.0), "pinky": (0.0, -0.008, 0.028),
    "index": (-0.004, -0.018, -0.013), "thumb": (0.007, 0.0, -0.027),
    "heel": (-0.005, -0.004, 0.014), "foot_index": (0.017, 0.006, -0.011),
}  # fmt: skip
# Points of the face: x toward the person's left and y upward, from the middle of the eyes, in
# distances between the eyes. Chosen: an average face.
_FACE = {
    "nose": (0.0, -0.65), "eye_inner": (0.28, 0.0), "eye": (0.5, 0.0), "eye_outer": (0.75, 0.0),
    "mouth": (0.4, -1.15),
}  # fmt: skip
# Standard deviations of offsets, metres; chosen by eye.
_FACE_SPREAD, _EAR_SPREAD, _FOOT_SPREAD = 0.015, 0.030, 0.015
_OTHER_HIP_SPREAD = 0.050  # of keypoints' hips
_KNUCKLE_SPREAD, _TIP_SPREAD = 0.006, 0.005
_FINGER_NAMES = ("thumb", "index", "middle", "ring", "pinky")
# Bones by which the sizes of two skeletons are compared.
_LONG_BONES = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))


class RigPoint(NamedTuple):
    """Where a landmark sits on the body."""

    joint: int  # that it moves with, an index of ``JOINTS``
    vertex: int | None  # that it is; None: it is the joint itself
    offset_spread: float  # metres


@dataclass(frozen=True)
class LandmarkRig:
    """P landmarks on a body.

    Attributes:
        names: of the P landmarks, as in :mod:`gva_mi.subject.landmarks`.
        joints: (P,) the joint that each moves with, an index of ``JOINTS``.
        rest: (P, 3) places in the T-pose of the mean person, metres.
        directions: (B, P, 3) how one standard deviation of each beta moves them, metres.
        offset_spread: (P,) standard deviation of a coordinate of the constant offset, metres.
    """

    names: tuple[str, ...]
    joints: Tensor
    rest: Tensor
    directions: Tensor
    offset_spread: Tensor

    @staticmethod
    def of(body: BodyModel, names: Sequence[str], at_joints: Collection[str] = ()) -> LandmarkRig:
        """Find landmarks on a body; unknown ``names`` are left out.

        ``at_joints`` are those that lie at the joint itself (:class:`Landmarks`).

        Raises:
            InputError: no name is known.
        """
        points = dict(_points(body))
        for hip in {"left_hip", "right_hip"}.intersection(at_joints):
            points[hip] = points[hip]._replace(offset_spread=_OTHER_HIP_SPREAD)
        known = tuple(name for name in names if name in points)
        if not known:
            raise InputError(f"landmarks: expected names such as {min(points)}, got {names[:3]}")
        joints, vertices, offset_spread = zip(*(points[name] for name in known), strict=True)
        at = torch.tensor([vertex or 0 for vertex in vertices])
        of_surface = torch.tensor([vertex is not None for vertex in vertices])[:, None]
        joints = torch.tensor(joints)
        count = len(body.v_template)
        moves = columns_of(body.shape_directions, at, count)[:, : 3 * len(known)]
        moves = moves.view(-1, 3, len(known)).mT
        marked = [(0.0, 0.0, 0.0) if name in at_joints else _marked(name) for name in known]
        marked = body.v_template.new_tensor(marked).view(-1, 3)
        joint_moves = body.shape_joints.view(-1, len(JOINTS), 3)[:, joints]
        return LandmarkRig(
            known,
            joints,
            torch.where(of_surface, body.v_template[at], body.j_template[joints]) + marked,
            torch.where(of_surface, moves, joint_moves),
            torch.tensor(offset_spread).to(body.v_template),
        )

    def joined(self, other: LandmarkRig) -> LandmarkRig:
        """Append the landmarks of another rig of the same body."""
        return LandmarkRig(
            self.names + other.names,
            torch.cat([self.joints, other.joints]),
            torch.cat([self.rest, other.rest]),
            torch.cat([self.directions, other.directions], 1),
            torch.cat([self.offset_spread, other.offset_spread]),
        )

    def at_rest(self, betas: Tensor) -> Tensor:
        """Return ``x`` (P, 3) of a shape (B,), metres; missing betas count as zero."""
        betas = betas[: len(self.directions)]
        return self.rest + torch.einsum("b,bpc->pc", betas, self.directions[: len(betas)])

    def places(self, T_world_rest: Tensor, betas: Tensor, offsets: Tensor) -> Tensor:
        """Return the landmarks (T, P, 3) of eq. 1, world, metres; differentiable.

        Args:
            T_world_rest: (T, 55, 4, 4) of :class:`gva_mi.body.smplx.Posed`.
            betas: (B,) of the shape.
            offsets: ``o`` (P, 3) metres.
        """
        x = self.at_rest(betas) + offsets
        T = T_world_rest[:, self.joints]
        return (T[..., :3, :3] @ x[:, :, None])[..., 0] + T[..., :3, 3]

    def scale(self, landmarks: Landmarks, betas: Tensor) -> float:
        """Return the factor from the network's metres to the metres of this body.

        Networks give metres for a person of average size. The factor is the median ratio of limb
        lengths over frames and limbs; 1 if no limb was seen.
        """
        x, metric, ratios = self.at_rest(betas), torch.from_numpy(landmarks.metric).to(betas), []
        for ends in _LONG_BONES:
            for side in SIDES:
                pair = [f"{side}_{end}" for end in ends]
                if not set(pair) <= set(self.names):
                    continue
                a, b = (x[self.names.index(name)] for name in pair)
                p, q = (metric[:, k] for k in landmarks.indices(pair))
                ratios.append((a - b).norm() / (p - q).norm(dim=1))
        found = torch.cat(ratios) if ratios else x.new_zeros(0)
        found = found[found.isfinite()]
        return float(found.median()) if len(found) else 1.0


def face_weights(A: Tensor, a: Tensor) -> Tensor:
    """Return ``f`` (T,), how well the face is seen: ``f = cos(angle to the camera)^4``.

    Landmarks of a face that is turned away are unreliable. The power is chosen by the heads of six
    rendered videos.

    Args:
        A: (T, 3, 3) rotations of the head in the camera's axes.
        a: (T, 3) places of the head in the camera's axes, metres.
    """
    return (-(A[:, :, 2] * normalize(a, dim=1)).sum(1)).clamp_min(0) ** 4


def _marked(name: str) -> tuple[float, float, float]:
    """Return what annotators mark, relative to the joint or vertex, metres in the T-pose."""
    aside, up, ahead = _MARKED.get(_without_side(name), (0.0, 0.0, 0.0))
    return -aside if "right" in name else aside, up, ahead


def _without_side(name: str) -> str:
    return "_".join(word for word in name.split("_") if word not in SIDES)


def _points(body: BodyModel) -> Iterator[tuple[str, RigPoint]]:
    """Yield the name and the place of every known landmark."""
    yield from _face(body)
    for side in SIDES:
        for name, (joint, offset_spread) in _JOINTS.items():
            at = JOINTS.index(f"{side}_{joint}")
            yield f"{side}_{name}", RigPoint(at, None, offset_spread)
        yield from _foot(body, side)
        names = iter(hand_names(side)[1:])
        for finger in _FINGER_NAMES:
            for k in (1, 2, 3):
                knuckle = JOINTS.index(f"{side}_{finger}{k}")
                yield next(names), RigPoint(knuckle, None, _KNUCKLE_SPREAD)
            bone = [JOINTS.index(f"{side}_{finger}{k}") for k in (2, 3)]
            along = body.j_template[bone[1]] - body.j_template[bone[0]]
            own = body.weights[:, bone[1]] > 0.5
            tip = _farthest(own, body.v_template @ along)
            yield next(names), RigPoint(bone[1], tip, _TIP_SPREAD)


def _face(body: BodyModel) -> Iterator[tuple[str, RigPoint]]:
    """Yield the landmarks of the face."""
    v, at = body.v_template, {name: body.j_template[k] for k, name in enumerate(JOINTS)}
    eyes = [at[f"{side}_eye_smplhf"] for side in SIDES]
    middle, wide = (eyes[0] + eyes[1]) / 2, (eyes[0] - eyes[1]).norm()
    head = JOINTS.index("head")
    own = body.weights[:, [head, JOINTS.index("jaw")]].sum(1)
    front = (own > 0.5) & (v[:, 2] > middle[2] - 0.3 * wide)
    for name in BODY_LANDMARKS[: BODY_LANDMARKS.index("left_shoulder")]:
        sign = -1 if "right" in name else 1
        if name.endswith("ear"):
            beside = v - (middle * v.new_tensor([1, 1, 0]) + at["head"] * v.new_tensor([0, 0, 1]))
            beside = beside + v.new_tensor([0, 0.3, 0]) * wide
            near = (own > 0.5) & (beside[:, 1:].abs() < 0.8 * wide).all(1)
            yield name, RigPoint(head, _farthest(near, sign * v[:, 0]), _EAR_SPREAD)
            continue
        x, y = _FACE[_without_side(name)]
        goal = middle[:2] + wide * v.new_tensor([sign * x, y])
        apart = (v[:, :2] - goal).norm(dim=1)
        # Of the points in front, the nearest; of equally near ones, the one farther in front.
        yield name, RigPoint(head, _farthest(front, 0.2 * v[:, 2] - apart), _FACE_SPREAD)


def _foot(body: BodyModel, side: str) -> Iterator[tuple[str, RigPoint]]:
    """Yield the heel and the tip of the toes."""
    v = body.v_template
    ankle, ball = (JOINTS.index(f"{side}_{name}") for name in ("ankle", "foot"))
    low = (body.j_template[ankle, 1] + v[:, 1].min()) / 2
    sole = (body.weights[:, [ankle, ball]].sum(1) > 0.6) & (v[:, 1] < low)
    yield f"{side}_heel", RigPoint(ankle, _farthest(sole, -v[:, 2]), _FOOT_SPREAD)
    yield f"{side}_foot_index", RigPoint(ball, _farthest(sole, v[:, 2]), _FOOT_SPREAD)


def _farthest(which: Tensor, score: Tensor) -> int | None:
    """Return the vertex of the largest score among some; None if there is none."""
    if not bool(which.any()):
        return None
    return int(torch.where(which, score, -torch.inf).argmax())
