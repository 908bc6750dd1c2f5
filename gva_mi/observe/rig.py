"""Landmarks of a network: where they sit on the body, and how far a pose is from them.

A landmark moves rigidly with one joint. With the rest point ``x_p(β)`` of landmark ``p``, which is
a joint or a vertex of the body and linear in the shape, and the transform of its joint,

1. ``y_p = T_world_rest[joint(p)] (x_p(β) + o_p)``.

People who label pictures mark a hip, a shoulder or a knuckle a few centimetres off the joint of a
body model. ``o_p`` is that difference: constant in a video, with the standard deviation
``spread_p``.

As evidence of stage 2 they compare where the body's points lie in the picture:

2. ``r_kp = S_kp (π_k(y_kp) - u_kp) / σ_kp``
3. ``L_k = Σ_p n_p (ν + 2) / 2m · log(1 + |r_kp|² / ν)``
4. ``E(o) = Σ_p |o_p|² / 2 loose_p²``
5. ``L_k += f_k |A_k - A_k^stage1|² / 4 m σ_A²``: where the face was seen

with the landmark ``u`` in pixels, its standard deviation ``σ`` and aspect ``S``
(:mod:`gva_mi.observe.landmark_noise`), and the camera's projection ``π``. A landmark's error
lasts, so ``m`` frames count as one, and the points of a hand, or of the face, err together, so they
count as few: each as ``n`` of a point.

The points of the face network are not compared again: stage 1 found the head's rotation ``A`` in
the world by them, with a standard deviation ``σ_A`` about each axis, best where the face looks at
the camera (``f``). What else moves the trunk does not turn that head.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, SIDES, Pose, Shape
from gva_mi.body.smplx import BodyModel, columns_of
from gva_mi.observe.landmark_noise import LandmarkNoise, independent_points
from gva_mi.prior.error_model import FREEDOM
from gva_mi.splat import Camera
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS, Landmarks, hand_names

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
_FACE_SPREAD, _EAR_SPREAD, _FOOT_SPREAD = 0.015, 0.030, 0.015  # metres
_KNUCKLE_SPREAD, _TIP_SPREAD = 0.006, 0.005
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# Bones by which two skeletons' sizes are compared.
_LONG = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
# Seconds for which a landmark's error lasts: more than in stage 1, whose poses follow it already.
MEMORY = 0.2
HEAD_SPREAD = np.radians(4.5)  # σ_A
NEAREST = 0.1  # metres in front of the camera, below which nothing is projected
_HEAD = JOINTS.index("head")
_OF_FRAMES = ("pixels", "precision", "aspect", "K", "T_camera_world", "head", "faces")


@dataclass(frozen=True)
class LandmarkRig:
    """P landmarks on a body.

    Attributes:
        names: P, of :mod:`gva_mi.subject.landmarks`.
        joints: (P,) the joint that each moves with, an index of ``JOINTS``.
        rest: (P, 3) metres, in the T-pose of the mean person.
        directions: (B, P, 3) metres, what one standard deviation of each beta adds.
        offset_spread: (P,) standard deviation of the constant offset's coordinates, metres.
    """

    names: tuple[str, ...]
    joints: Tensor
    rest: Tensor
    directions: Tensor
    offset_spread: Tensor

    @staticmethod
    def of(body: BodyModel, names: Sequence[str]) -> LandmarkRig:
        """Find landmarks on a body; ``names`` that are not known are left out."""
        points = dict(_points(body))
        known = tuple(name for name in names if name in points)
        joints, vertices, offset_spread = zip(*(points[name] for name in known), strict=True)
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
            torch.tensor(offset_spread).to(body.v_template),
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


@dataclass(frozen=True)
class SeenLandmarks:
    """P landmarks in T frames, on the body's rig.

    Attributes:
        rig: of the P landmarks.
        pixels: (T, P, 2), zero where there is none.
        precision: (T, P) 1 / σ, zero where there is none.
        aspect: (T, P, 2, 2) ``S``.
        count: (P,) ``n``.
        K: (T, 3, 3) of the cameras.
        T_camera_world: (T, 4, 4).
        memory: ``m``.
        head: (T, 3, 3) ``A^stage1``.
        faces: (T,) ``f``, zero without a face.
    """

    rig: LandmarkRig
    pixels: Tensor
    precision: Tensor
    aspect: Tensor
    count: Tensor
    K: Tensor
    T_camera_world: Tensor
    memory: float
    head: Tensor
    faces: Tensor

    @staticmethod
    def of(
        landmarks: Landmarks,
        body: BodyModel,
        cameras: Sequence[Camera],
        fps: float,
        stage1: tuple[Pose, Shape],
    ) -> SeenLandmarks:
        """Take the landmarks that are known on a body, seen by T cameras, ``fps`` a second.

        Args:
            landmarks: of T frames.
            body: of the poses.
            cameras: T of them.
            fps: frames a second.
            stage1: T poses that were found by the same landmarks, and their shape.
        """
        rig = LandmarkRig.of(body, landmarks.names)
        T_camera_world = torch.from_numpy(np.stack([c.T_camera_world for c in cameras])).float()
        head, faces = _heads(landmarks, body, T_camera_world, *stage1)
        noise = LandmarkNoise.of(landmarks, rig.names)
        pixels = torch.from_numpy(landmarks.pixels[:, landmarks.indices(rig.names)]).float()
        return SeenLandmarks(
            rig,
            torch.where(noise.pixels.isfinite()[..., None], pixels, 0),
            1 / noise.pixels,
            noise.aspect,
            independent_points(rig.names, hands_together=True),
            torch.from_numpy(np.stack([c.K for c in cameras])).float(),
            T_camera_world,
            max(1.0, MEMORY * fps),
            head,
            faces,
        )

    def part(self, frames: range) -> SeenLandmarks:
        """Return the landmarks of some consecutive frames."""
        some = slice(frames.start, frames.stop)
        cut = {name: getattr(self, name)[some] for name in _OF_FRAMES}
        return replace(self, **cut)

    def losses(
        self, frames: Sequence[int], T_world_rest: Tensor, shape: Shape, offsets: Tensor
    ) -> Tensor:
        """Return eq. 3 and 5 (B,), nats, of B frames; differentiable.

        Args:
            frames: B numbers.
            T_world_rest: (B, J, 4, 4) of the person's joints in these frames.
            shape: of the person.
            offsets: ``o`` (P, 3) metres.
        """
        frames = list(frames)
        T, y = self.T_camera_world[frames], self.rig.places(T_world_rest, shape.betas, offsets)
        seen = y @ T[:, :3, :3].mT + T[:, None, :3, 3]
        image = seen @ self.K[frames].mT
        found = image[..., :2] / image[..., 2:].clamp_min(NEAREST)
        off = (self.aspect[frames] @ (found - self.pixels[frames])[..., None])[..., 0]
        off = off.square().sum(-1) * self.precision[frames].square()
        nats = (FREEDOM + 2) / (2 * self.memory) * torch.log1p(off / FREEDOM)
        turned = (T_world_rest[:, _HEAD, :3, :3] - self.head[frames]).square().sum((1, 2))
        of_head = self.faces[frames] * turned / (4 * self.memory * HEAD_SPREAD**2)
        return (self.count * nats).sum(1) + of_head

    def energy(self, offsets: Tensor) -> Tensor:
        """Return eq. 4 of offsets (P, 3), nats."""
        return (offsets / self.rig.offset_spread[:, None]).square().sum() / 2


def _heads(
    landmarks: Landmarks, body: BodyModel, T_camera_world: Tensor, pose: Pose, shape: Shape
) -> tuple[Tensor, Tensor]:
    """Return ``A^stage1`` (T, 3, 3) and ``f`` (T,)."""
    joints = body.rest(shape).joints
    T_world_rest = turn_joints(pose.rotations, joints, PARENTS, pose.transl)[1][:, _HEAD]
    T = T_camera_world @ T_world_rest
    places = T[:, :3, :3] @ joints[_HEAD] + T[:, :3, 3]
    faces = torch.zeros(len(T))
    if set(FACE_LANDMARKS) <= set(landmarks.names):
        confidence = landmarks.confidence[:, landmarks.indices(FACE_LANDMARKS)].min(1)
        faces = torch.from_numpy(np.nan_to_num(confidence)).float() * facing(T[:, :3, :3], places)
    return T_world_rest[:, :3, :3], faces


def facing(A: Tensor, a: Tensor) -> Tensor:
    """Return ``f`` (T,) of a head's rotations (T, 3, 3) and places (T, 3) in the camera's axes.

    A face seen aslant is read badly: ``f = cos(angle to the camera)^8``.
    """
    return (-(A[:, :, 2] * normalize(a, dim=1)).sum(1)).clamp_min(0) ** 8


def _marked(name: str) -> tuple[float, float, float]:
    """Return what a label marks relative to its joint or vertex, metres in the T-pose."""
    aside, up, ahead = _MARKED.get(_without_side(name), (0.0, 0.0, 0.0))
    return -aside if "right" in name else aside, up, ahead


def _without_side(name: str) -> str:
    return "_".join(word for word in name.split("_") if word not in SIDES)


def _points(body: BodyModel) -> Iterator[tuple[str, tuple[int, int, float]]]:
    """Yield names with the joint, the vertex or -1 for the joint itself, and ``offset_spread``."""
    for name, (vertex, offset_spread) in _face(body).items():
        yield name, (JOINTS.index("head"), vertex, offset_spread)
    for side in SIDES:
        for name, (joint, offset_spread) in _JOINTS.items():
            yield f"{side}_{name}", (JOINTS.index(f"{side}_{joint}"), -1, offset_spread)
        yield from _foot(body, side)
        names = iter(hand_names(side)[1:])
        for finger in _FINGERS:
            for k in (1, 2, 3):
                yield next(names), (JOINTS.index(f"{side}_{finger}{k}"), -1, _KNUCKLE_SPREAD)
            bone = [JOINTS.index(f"{side}_{finger}{k}") for k in (2, 3)]
            along = body.j_template[bone[1]] - body.j_template[bone[0]]
            own = body.weights[:, bone[1]] > 0.5
            yield next(names), (bone[1], _farthest(own, body.v_template @ along), _TIP_SPREAD)


def _face(body: BodyModel) -> dict[str, tuple[int, float]]:
    """Return the vertex and ``offset_spread`` of every landmark of the face."""
    v, at = body.v_template, {name: body.j_template[k] for k, name in enumerate(JOINTS)}
    eyes = [at[f"{side}_eye_smplhf"] for side in SIDES]
    middle, wide = (eyes[0] + eyes[1]) / 2, (eyes[0] - eyes[1]).norm()
    own = body.weights[:, [JOINTS.index("head"), JOINTS.index("jaw")]].sum(1)
    front = (own > 0.5) & (v[:, 2] > middle[2] - 0.3 * wide)
    found = {}
    for name in BODY_LANDMARKS[: BODY_LANDMARKS.index("left_shoulder")]:
        sign = -1 if "right" in name else 1
        if name.endswith("ear"):
            beside = v - (middle * v.new_tensor([1, 1, 0]) + at["head"] * v.new_tensor([0, 0, 1]))
            beside = beside + v.new_tensor([0, 0.3, 0]) * wide
            near = (own > 0.5) & (beside[:, 1:].abs() < 0.8 * wide).all(1)
            found[name] = _farthest(near, sign * v[:, 0]), _EAR_SPREAD
            continue
        x, y = _FACE[_without_side(name)]
        goal = middle[:2] + wide * v.new_tensor([sign * x, y])
        apart = (v[:, :2] - goal).norm(dim=1)
        # Of the points in front, the nearest; of equally near ones, the one farther in front.
        found[name] = _farthest(front, 0.2 * v[:, 2] - apart), _FACE_SPREAD
    return found


def _foot(body: BodyModel, side: str) -> Iterator[tuple[str, tuple[int, int, float]]]:
    """Yield the heel and the tip of the toes."""
    v = body.v_template
    ankle, ball = (JOINTS.index(f"{side}_{name}") for name in ("ankle", "foot"))
    low = (body.j_template[ankle, 1] + v[:, 1].min()) / 2
    sole = (body.weights[:, [ankle, ball]].sum(1) > 0.6) & (v[:, 1] < low)
    yield f"{side}_heel", (ankle, _farthest(sole, -v[:, 2]), _FOOT_SPREAD)
    yield f"{side}_foot_index", (ball, _farthest(sole, v[:, 2]), _FOOT_SPREAD)


def _farthest(which: Tensor, score: Tensor) -> int:
    """Return the vertex with the largest score among some; -1 if there is none."""
    if not bool(which.any()):
        return -1
    return int(torch.where(which, score, -torch.inf).argmax())
