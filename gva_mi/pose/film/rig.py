"""Where a network's landmarks sit on the body.

A landmark moves rigidly with one joint. With the rest point ``x_p(β)`` of landmark ``p``, which is
a joint or a vertex of the body and linear in the shape, and the transform of its joint,

1. ``y_p = T_world_rest[joint(p)] (x_p(β) + o_p)``.

People who label pictures mark a hip, a shoulder or a knuckle a few centimetres off the joint of a
body model. ``o_p`` is that difference: constant in a film, with the standard deviation ``loose_p``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.smplx import BodyModel, columns_of
from gva_mi.data.landmarks import BODY, Landmarks, hand_names

# Landmarks that are joints, and how far off, metres (1σ). A name of two sides lacks its side.
_JOINTS = {
    "shoulder": ("shoulder", 0.020), "elbow": ("elbow", 0.015), "wrist": ("wrist", 0.012),
    "hip": ("hip", 0.020), "knee": ("knee", 0.015), "ankle": ("ankle", 0.012),
    "pinky": ("pinky1", 0.012), "index": ("index1", 0.012), "thumb": ("thumb2", 0.012),
    "hand_wrist": ("wrist", 0.015),
}  # fmt: skip
# What labels mark, relative to those joints and to the points of feet below: metres
# outward from the body's middle, upward and forward in the T-pose. Means of BlazePose's answers.
_MARKED = {
    "shoulder": (-0.022, 0.025, 0.0), "elbow": (-0.006, 0.0, 0.010), "hip": (0.018, -0.003, 0.0),
    "knee": (0.0, 0.007, 0.0), "ankle": (-0.005, 0.011, 0.0), "pinky": (0.0, -0.008, 0.028),
    "index": (-0.004, -0.018, -0.013), "thumb": (0.007, 0.0, -0.027),
    "heel": (-0.005, -0.004, 0.014), "foot_index": (0.017, 0.006, -0.011),
}  # fmt: skip
# Points of the face: x toward the person's left and y upward, from the middle of the eyes, in
# distances between the eyes.
_FACE = {
    "nose": (0.0, -0.65), "eye_inner": (0.28, 0.0), "eye": (0.5, 0.0), "eye_outer": (0.75, 0.0),
    "mouth": (0.4, -1.15),
}  # fmt: skip
_FACE_LOOSE, _EAR_LOOSE, _FOOT_LOOSE = 0.015, 0.030, 0.015  # metres
_KNUCKLE_LOOSE, _TIP_LOOSE = 0.006, 0.005
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# Bones by which two skeletons' sizes are compared.
_LONG = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))


@dataclass(frozen=True)
class LandmarkRig:
    """P landmarks on a body.

    Attributes:
        names: P, of :mod:`gva_mi.data.landmarks`.
        joints: (P,) the joint that each moves with, an index of ``JOINTS``.
        rest: (P, 3) metres, in the T-pose of the mean person.
        directions: (B, P, 3) metres, what one standard deviation of each beta adds.
        loose: (P,) standard deviation of the constant offset's coordinates, metres.
    """

    names: tuple[str, ...]
    joints: Tensor
    rest: Tensor
    directions: Tensor
    loose: Tensor

    @staticmethod
    def of(body: BodyModel, names: Sequence[str]) -> LandmarkRig:
        """Find landmarks on a body; ``names`` that are not known are left out."""
        points = dict(_points(body))
        known = tuple(name for name in names if name in points)
        joints, vertices, loose = zip(*(points[name] for name in known), strict=True)
        at = torch.tensor([max(v, 0) for v in vertices])
        of_surface = torch.tensor([v >= 0 for v in vertices])[:, None]
        joints = torch.tensor(joints)
        count, betas = len(body.v_template), body.num_betas
        moves = columns_of(body.shape_directions, at, count)[:, : 3 * len(known)]
        moves = moves.view(betas, 3, -1).mT
        marked = body.v_template.new_tensor([_marked(name) for name in known]).view(-1, 3)
        joint_moves = body.shape_joints.view(betas, -1, 3)[:, joints]
        return LandmarkRig(
            known,
            joints,
            torch.where(of_surface, body.v_template[at], body.j_template[joints]) + marked,
            torch.where(of_surface, moves, joint_moves),
            torch.tensor(loose).to(body.v_template),
        )

    def at_rest(self, betas: Tensor) -> Tensor:
        """Return ``x`` (P, 3) of a shape (B,), metres; missing coefficients count as zero."""
        betas = betas[: len(self.directions)]
        return self.rest + torch.einsum("b,bpc->pc", betas, self.directions[: len(betas)])

    def places(self, T_world_rest: Tensor, betas: Tensor, offsets: Tensor) -> Tensor:
        """Return eq. 1: the landmarks (T, P, 3), metres, world; differentiable.

        Args:
            T_world_rest: (T, 55, 4, 4) of :class:`gva_mi.body.smplx.Posed`.
            betas: (B,) of the shape.
            offsets: ``o`` (P, 3) metres.
        """
        x = self.at_rest(betas) + offsets
        T = T_world_rest[:, self.joints]
        return (T[..., :3, :3] @ x[:, :, None])[..., 0] + T[..., :3, 3]

    def scale(self, landmarks: Landmarks, betas: Tensor) -> float:
        """Return how many times longer the limbs are than those of ``landmarks.metric``.

        Networks give metres for a person of average size. The median over frames and limbs is
        used; without any limb it is 1.
        """
        x, metric, ratios = self.at_rest(betas), torch.from_numpy(landmarks.metric).to(betas), []
        for ends in _LONG:
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


def _marked(name: str) -> tuple[float, float, float]:
    """Return what a label marks relative to its joint or vertex, metres in the T-pose."""
    aside, up, ahead = _MARKED.get(_without_side(name), (0.0, 0.0, 0.0))
    return -aside if "right" in name else aside, up, ahead


def _without_side(name: str) -> str:
    return "_".join(word for word in name.split("_") if word not in SIDES)


def _points(body: BodyModel) -> Iterator[tuple[str, tuple[int, int, float]]]:
    """Yield names with the joint, the vertex or -1 for the joint itself, and ``loose``."""
    for name, (vertex, loose) in _face(body).items():
        yield name, (JOINTS.index("head"), vertex, loose)
    for side in SIDES:
        for name, (joint, loose) in _JOINTS.items():
            yield f"{side}_{name}", (JOINTS.index(f"{side}_{joint}"), -1, loose)
        yield from _foot(body, side)
        names = iter(hand_names(side)[1:])
        for finger in _FINGERS:
            for k in (1, 2, 3):
                yield next(names), (JOINTS.index(f"{side}_{finger}{k}"), -1, _KNUCKLE_LOOSE)
            bone = [JOINTS.index(f"{side}_{finger}{k}") for k in (2, 3)]
            along = body.j_template[bone[1]] - body.j_template[bone[0]]
            own = body.weights[:, bone[1]] > 0.5
            yield next(names), (bone[1], _farthest(own, body.v_template @ along), _TIP_LOOSE)


def _face(body: BodyModel) -> dict[str, tuple[int, float]]:
    """Return the vertex and ``loose`` of every landmark of the face."""
    v, at = body.v_template, {name: body.j_template[k] for k, name in enumerate(JOINTS)}
    eyes = [at[f"{side}_eye_smplhf"] for side in SIDES]
    middle, wide = (eyes[0] + eyes[1]) / 2, (eyes[0] - eyes[1]).norm()
    own = body.weights[:, [JOINTS.index("head"), JOINTS.index("jaw")]].sum(1)
    front = (own > 0.5) & (v[:, 2] > middle[2] - 0.3 * wide)
    found = {}
    for name in BODY[: BODY.index("left_shoulder")]:
        sign = -1 if "right" in name else 1
        if name.endswith("ear"):
            beside = v - (middle * v.new_tensor([1, 1, 0]) + at["head"] * v.new_tensor([0, 0, 1]))
            beside = beside + v.new_tensor([0, 0.3, 0]) * wide
            near = (own > 0.5) & (beside[:, 1:].abs() < 0.8 * wide).all(1)
            found[name] = _farthest(near, sign * v[:, 0]), _EAR_LOOSE
            continue
        x, y = _FACE[_without_side(name)]
        goal = middle[:2] + wide * v.new_tensor([sign * x, y])
        apart = (v[:, :2] - goal).norm(dim=1)
        # Of the points in front, the nearest; of equally near ones, the one farther in front.
        found[name] = _farthest(front, 0.2 * v[:, 2] - apart), _FACE_LOOSE
    return found


def _foot(body: BodyModel, side: str) -> Iterator[tuple[str, tuple[int, int, float]]]:
    """Yield the heel and the tip of the toes."""
    v = body.v_template
    ankle, ball = (JOINTS.index(f"{side}_{name}") for name in ("ankle", "foot"))
    low = (body.j_template[ankle, 1] + v[:, 1].min()) / 2
    sole = (body.weights[:, [ankle, ball]].sum(1) > 0.6) & (v[:, 1] < low)
    yield f"{side}_heel", (ankle, _farthest(sole, -v[:, 2]), _FOOT_LOOSE)
    yield f"{side}_foot_index", (ball, _farthest(sole, v[:, 2]), _FOOT_LOOSE)


def _farthest(which: Tensor, score: Tensor) -> int:
    """Return the vertex with the largest score among some; -1 if there is none."""
    if not bool(which.any()):
        return -1
    return int(torch.where(which, score, -torch.inf).argmax())
