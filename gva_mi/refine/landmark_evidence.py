"""Evidence from landmarks: how far a pose is from what the networks saw.

The points of :class:`gva_mi.observe.rig.LandmarkRig` on the posed body are compared with the
landmarks in the picture:

1. ``r_kp = S_kp (π_k(y_kp) - u_kp) / σ_kp``
2. ``L_k = Σ_p n_p (ν + 2) / 2m · log(1 + |r_kp|² / ν)``
3. ``E(o) = Σ_p |o_p|² / 2 offset_spread_p²``
4. ``L_k += f_k |A_k - A_k^stage1|² / 4 m σ_A²``: where the face was seen

with the landmark ``u`` in pixels, its standard deviation ``σ`` and whitening ``S``
(:mod:`gva_mi.observe.landmark_noise`), and the camera's projection ``π``. The errors of a landmark
last, so ``m`` frames count as one. The points of a hand, or of the face, err together, so each has
a weight ``n`` below 1.

The points of the face network are not compared again: stage 1 found the head's rotation ``A`` in
the world by them, with a standard deviation ``σ_A`` about each axis, and best where the face looks
at the camera (weight ``f``). Eq. 4 keeps this rotation when other evidence turns the trunk.
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
from gva_mi.observe.landmark_noise import LandmarkNoise, independent_points
from gva_mi.observe.rig import LandmarkRig, face_weights
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.splat import Camera
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

# m, frames. Chosen as 0.2 s of 30 frames a second; at another rate masks, which stand beside the
# landmarks, repeat their errors as often, so m stays.
CORRELATED_FRAMES = 6
HEAD_SIGMA = np.radians(4.5)  # σ_A, radians; chosen by eye
# Metres in front of the camera; nearer points are projected as if there; chosen.
NEAREST_DEPTH = 0.1
_HEAD = JOINTS.index("head")
# Fields of SeenLandmarks that begin with the frames.
_OF_FRAMES = (
    "pixels", "precision", "whitening", "K", "T_camera_world", "head_rotations", "face_weights",
)  # fmt: skip


@dataclass(frozen=True)
class SeenLandmarks:
    """P landmarks in T frames, with the body's rig and the cameras.

    Attributes:
        rig: of the P landmarks.
        pixels: (T, P, 2); zero without a landmark.
        precision: (T, P) 1 / σ; zero without a landmark.
        whitening: (T, P, 2, 2) ``S``.
        point_weights: (P,) ``n``.
        K: (T, 3, 3) of the cameras.
        T_camera_world: (T, 4, 4).
        head_rotations: (T, 3, 3) ``A^stage1``.
        face_weights: (T,) ``f``; zero without a face.
    """

    rig: LandmarkRig
    pixels: Tensor
    precision: Tensor
    whitening: Tensor
    point_weights: Tensor
    K: Tensor
    T_camera_world: Tensor
    head_rotations: Tensor
    face_weights: Tensor

    @staticmethod
    def of(
        landmarks: Landmarks,
        body: BodyModel,
        cameras: Sequence[Camera],
        pose: Pose,
        shape: Shape,
    ) -> SeenLandmarks:
        """Take the landmarks that the body's rig knows.

        Args:
            landmarks: of T frames.
            body: of the poses.
            cameras: T of them.
            pose: T frames of stage 1, which was solved from the same landmarks.
            shape: of the person, by stage 1.
        """
        rig = LandmarkRig.of(body, landmarks.names, landmarks.at_joints)
        T_camera_world = torch.from_numpy(np.stack([c.T_camera_world for c in cameras])).float()
        head, faces = _heads(landmarks, body, T_camera_world, pose, shape)
        noise = LandmarkNoise.of(landmarks, rig.names)
        pixels = torch.from_numpy(landmarks.pixels[:, landmarks.indices(rig.names)]).float()
        return SeenLandmarks(
            rig=rig,
            pixels=torch.where(noise.pixels.isfinite()[..., None], pixels, 0),
            precision=1 / noise.pixels,
            whitening=noise.whitening,
            point_weights=independent_points(rig.names, group_hands=True),
            K=torch.from_numpy(np.stack([c.K for c in cameras])).float(),
            T_camera_world=T_camera_world,
            head_rotations=head,
            face_weights=faces,
        )

    def part(self, frames: range) -> SeenLandmarks:
        """Return the landmarks of consecutive frames."""
        some = slice(frames.start, frames.stop)
        return replace(self, **{name: getattr(self, name)[some] for name in _OF_FRAMES})

    def losses(
        self, frames: Sequence[int], T_world_rest: Tensor, shape: Shape, offsets: Tensor
    ) -> Tensor:
        """Return eq. 2 and 4 of B frames (B,), nats; differentiable.

        Args:
            frames: their B numbers.
            T_world_rest: (B, J, 4, 4) of the person's joints in these frames.
            shape: of the person.
            offsets: ``o`` (P, 3) metres.
        """
        frames = list(frames)
        T, y = self.T_camera_world[frames], self.rig.places(T_world_rest, shape.betas, offsets)
        seen = y @ T[:, :3, :3].mT + T[:, None, :3, 3]
        image = seen @ self.K[frames].mT
        found = image[..., :2] / image[..., 2:].clamp_min(NEAREST_DEPTH)
        off = (self.whitening[frames] @ (found - self.pixels[frames])[..., None])[..., 0]
        off = off.square().sum(-1) * self.precision[frames].square()
        nats = (STUDENT_DOF + 2) / (2 * CORRELATED_FRAMES) * torch.log1p(off / STUDENT_DOF)
        turned = (T_world_rest[:, _HEAD, :3, :3] - self.head_rotations[frames]).square().sum((1, 2))
        of_head = self.face_weights[frames] * turned / (4 * CORRELATED_FRAMES * HEAD_SIGMA**2)
        return (self.point_weights * nats).sum(1) + of_head

    def energy(self, offsets: Tensor) -> Tensor:
        """Return eq. 3 of offsets (P, 3), nats."""
        return (offsets / self.rig.offset_spread[:, None]).square().sum() / 2


def _heads(
    landmarks: Landmarks, body: BodyModel, T_camera_world: Tensor, pose: Pose, shape: Shape
) -> tuple[Tensor, Tensor]:
    """Return the head's rotations ``A^stage1`` (T, 3, 3) and the weights ``f`` (T,) of the face."""
    joints = body.rest(shape).joints
    T_world_rest = turn_joints(pose.rotations, joints, PARENTS, pose.transl)[1][:, _HEAD]
    T = T_camera_world @ T_world_rest
    places = T[:, :3, :3] @ joints[_HEAD] + T[:, :3, 3]
    faces = torch.zeros(len(T))
    if set(FACE_LANDMARKS) <= set(landmarks.names):
        confidence = landmarks.confidence[:, landmarks.indices(FACE_LANDMARKS)].min(1)
        faces = torch.from_numpy(np.nan_to_num(confidence)).float()
        faces = faces * face_weights(T[:, :3, :3], places)
    return T_world_rest[:, :3, :3], faces
