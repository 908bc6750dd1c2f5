"""Landmarks of a network as evidence: where the body's points lie in the picture.

1. ``r_kp = S_kp (π_k(y_kp) - u_kp) / σ_kp``,   ``y_kp = T_k,joint(p) (x_p(β) + o_p)``
2. ``L_k = Σ_p n_p (ν + 2) / 2m · log(1 + |r_kp|² / ν)``
3. ``E(o) = Σ_p |o_p|² / 2 loose_p²``
4. ``L_k += f_k |A_k - A_k^stage1|² / 4 m σ_A²``: where the face was seen

with the landmark ``u`` in pixels, its standard deviation ``σ`` and aspect ``S``
(:mod:`gva_mi.pose.film.landmark_noise`), the camera's projection ``π``, and the point ``x`` of the
body at rest (:mod:`gva_mi.pose.film.rig`). Offsets ``o`` are unknown and
the same in all frames: a network's hip or shoulder is not the joint of the body. A landmark's error
lasts, so ``m`` frames count as one, and the points of a hand, or of the face, err together, so they
count as few: each as ``n`` of a point.

The points of the face network are not compared again: stage 1 found the head's rotation ``A`` in
the world by them, with a standard deviation ``σ_A`` about each axis, best where the face looks at
the camera (``f``). What else moves the trunk does not turn that head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.landmarks import FACE, Landmarks
from gva_mi.pose.film.face import facing
from gva_mi.pose.film.landmark_noise import LandmarkNoise, independent_points
from gva_mi.pose.film.rig import LandmarkRig
from gva_mi.pose.prior.error_model import FREEDOM
from gva_mi.splat import Camera

# Seconds for which a landmark's error lasts: more than in stage 1, whose poses follow it already.
MEMORY = 0.2
HEAD = np.radians(4.5)  # σ_A
NEAREST = 0.1  # metres in front of the camera, below which nothing is projected


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
        """Return eq. 2 (B,), nats, of B frames; differentiable.

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
        of_head = self.faces[frames] * turned / (4 * self.memory * HEAD**2)
        return (self.count * nats).sum(1) + of_head

    def energy(self, offsets: Tensor) -> Tensor:
        """Return eq. 3 of offsets (P, 3), nats."""
        return (offsets / self.rig.loose[:, None]).square().sum() / 2


def _heads(
    landmarks: Landmarks, body: BodyModel, T_camera_world: Tensor, pose: Pose, shape: Shape
) -> tuple[Tensor, Tensor]:
    """Return ``A^stage1`` (T, 3, 3) and ``f`` (T,)."""
    joints = body.rest(shape).joints
    T_world_rest = turn_joints(pose.rotations, joints, PARENTS, pose.transl)[1][:, _HEAD]
    T = T_camera_world @ T_world_rest
    places = T[:, :3, :3] @ joints[_HEAD] + T[:, :3, 3]
    faces = torch.zeros(len(T))
    if set(FACE) <= set(landmarks.names):
        confidence = landmarks.confidence[:, landmarks.indices(FACE)].min(1)
        faces = torch.from_numpy(np.nan_to_num(confidence)).float() * facing(T[:, :3, :3], places)
    return T_world_rest[:, :3, :3], faces


_HEAD = JOINTS.index("head")
_OF_FRAMES = ("pixels", "precision", "aspect", "K", "T_camera_world", "head", "faces")
