"""Evidence from landmarks: how far a pose is from what the networks saw.

The points of :class:`gva_mi.observe.rig.LandmarkRig` on the posed body are compared with the
landmarks in the picture:

1. ``r_kp = S_kp (π_k(y_kp) - u_kp) / σ_kp``
2. ``L_k = Σ_p n_p (ν + 2) / 2 · log(1 + |r_kp|² / ν)``
3. ``E(o) = Σ_p |o_p|² / 2 offset_spread_p²``

with the landmark ``u`` in pixels, its standard deviation ``σ`` and whitening ``S``
(:mod:`gva_mi.observe.landmark_noise`), and the camera's projection ``π``. The errors of a landmark
last for some frames, and the points of a hand, or of the face, err together. So in each frame a
landmark counts as ``n`` independent ones, fewer than one.

Of the face network's points, nose and eyes are compared: they move with the head alone. They are
far more exact than the points of the face that the body network gives
(:mod:`gva_mi.observe.face_points`).
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
from gva_mi.core.cpu import sqrt
from gva_mi.observe.face_points import INDEPENDENT_POINTS, NOSE_AND_EYES, FacePoints, seen_face
from gva_mi.observe.landmark_noise import LandmarkNoise, independent_points
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.splat import Camera
from gva_mi.subject.landmarks import Landmarks

# So many frames repeat one error of a landmark. Chosen as 0.2 s of 30 frames a second; at another
# rate masks, which stand beside the landmarks, repeat their errors as often, so it stays.
CORRELATED_FRAMES = 6
# Metres in front of the camera; nearer points are projected as if there; chosen.
NEAREST_DEPTH = 0.1
_HEAD = JOINTS.index("head")
_OF_FRAMES = ("pixels", "scale", "K", "T_camera_world")  # fields that begin with the frames


@dataclass(frozen=True)
class SeenLandmarks:
    """P landmarks in T frames, with the body's rig and the cameras.

    Attributes:
        rig: of the P landmarks.
        pixels: (T, P, 2) ``u``; zero without a landmark.
        scale: (T, P, 2, 2) ``S / σ``; zero without a landmark.
        counts: (P,) ``n``.
        K: (T, 3, 3) of the cameras.
        T_camera_world: (T, 4, 4).
    """

    rig: LandmarkRig
    pixels: Tensor
    scale: Tensor
    counts: Tensor
    K: Tensor
    T_camera_world: Tensor

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
            pose: T frames, which tell how well each face is seen.
            shape: of the person.
        """
        rig = LandmarkRig.of(body, landmarks.names, landmarks.at_joints)
        noise = LandmarkNoise.of(landmarks, rig.names)
        pixels = torch.from_numpy(landmarks.pixels[:, landmarks.indices(rig.names)]).float()
        found = SeenLandmarks(
            rig=rig,
            pixels=torch.where(noise.pixels.isfinite()[..., None], pixels, 0),
            scale=noise.whitening / noise.pixels[..., None, None],
            counts=independent_points(rig.names, group_hands=True) / CORRELATED_FRAMES,
            K=torch.from_numpy(np.stack([c.K for c in cameras])).float(),
            T_camera_world=torch.from_numpy(np.stack([c.T_camera_world for c in cameras])).float(),
        )
        return found._with_face(landmarks, body, pose, shape)

    def _with_face(
        self, landmarks: Landmarks, body: BodyModel, pose: Pose, shape: Shape
    ) -> SeenLandmarks:
        """Append nose and eyes, if a network looked for them and the body has a face."""
        points, joints = FacePoints.of(body), body.rest(shape).joints
        if points is None:
            return self
        T = turn_joints(pose.rotations, joints, PARENTS, pose.transl)[1][:, _HEAD]
        T = self.T_camera_world @ T
        place = T[:, :3, :3] @ joints[_HEAD] + T[:, :3, 3]
        face = seen_face(landmarks, T[:, :3, :3], place, self.K[:, 0, 0])
        if face is None:
            return self
        pixels, precision = (x[:, NOSE_AND_EYES] for x in face)
        count = INDEPENDENT_POINTS / len(NOSE_AND_EYES)
        return replace(
            self,
            rig=self.rig.joined(points.nose_and_eyes()),
            pixels=torch.cat([self.pixels, pixels], 1),
            scale=torch.cat([self.scale, sqrt(precision)[..., None, None] * torch.eye(2)], 1),
            counts=torch.cat([self.counts, torch.full((len(NOSE_AND_EYES),), count)]),
        )

    def part(self, frames: range) -> SeenLandmarks:
        """Return the landmarks of consecutive frames."""
        some = slice(frames.start, frames.stop)
        return replace(self, **{name: getattr(self, name)[some] for name in _OF_FRAMES})

    def losses(
        self, frames: Sequence[int], T_world_rest: Tensor, shape: Shape, offsets: Tensor
    ) -> Tensor:
        """Return eq. 2 of B frames (B,), nats; differentiable. Arguments: :meth:`errors`."""
        square = self.errors(frames, T_world_rest, shape, offsets).square().sum(-1)
        nats = (STUDENT_DOF + 2) / 2 * torch.log1p(square / STUDENT_DOF)
        return (self.counts * nats).sum(1)

    def errors(
        self, frames: Sequence[int], T_world_rest: Tensor, shape: Shape, offsets: Tensor
    ) -> Tensor:
        """Return eq. 1, (B, P, 2); differentiable.

        Args:
            frames: their B numbers.
            T_world_rest: (B, J, 4, 4) of the person's joints in these frames.
            shape: of the person.
            offsets: ``o`` (P, 3) metres.
        """
        frames = list(frames)
        T, y = self.T_camera_world[frames], self.rig.places(T_world_rest, shape.betas, offsets)
        image = (y @ T[:, :3, :3].mT + T[:, None, :3, 3]) @ self.K[frames].mT
        found = image[..., :2] / image[..., 2:].clamp_min(NEAREST_DEPTH)
        return (self.scale[frames] @ (found - self.pixels[frames])[..., None])[..., 0]

    def slopes(
        self, frames: Sequence[int], T_world_rest: Tensor, shape: Shape, offsets: Tensor
    ) -> Tensor:
        """Return the slopes of eq. 1 in the offsets, (B, P, 2, 3). Arguments: :meth:`errors`."""
        frames = list(frames)
        T, K = self.T_camera_world[frames], self.K[frames]
        y = self.rig.places(T_world_rest, shape.betas, offsets)
        A = K[:, None] @ T[:, None, :3, :3] @ T_world_rest[:, self.rig.joints, :3, :3]
        image = (y @ T[:, :3, :3].mT + T[:, None, :3, 3]) @ K.mT
        depth = image[..., 2:].clamp_min(NEAREST_DEPTH)
        by_offset = A[..., :2, :] - (image[..., :2] / depth)[..., None] * A[..., 2:, :]
        return self.scale[frames] @ (by_offset / depth[..., None])

    def energy(self, offsets: Tensor) -> Tensor:
        """Return eq. 3 of offsets (P, 3), nats."""
        return (offsets / self.rig.offset_spread[:, None]).square().sum() / 2
