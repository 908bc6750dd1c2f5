"""Landmarks of the face hold the head while poses are trained along with an avatar.

Pictures move a head only toward what the avatar has already learned. While the avatar's face is
blurred, each side of a turn may pull the head its own way, and the avatar gets two faces. The
landmarks ``u`` of eyes and nose, which move with the head alone, show its pose in each frame k:

1. ``X_kp = A_k (x_p + o_p) + a_k``
2. ``F_k = n Σ_p (ν + 2) / 2P · log(1 + |π_k(X_kp) - u_kp|² / ν σ_kp²)``

with the head's rotation ``A`` and place ``a`` in the camera's axes, the camera's projection ``π``,
places ``x`` on the body, and ``σ`` of :mod:`gva_mi.observe.face_points`. The P points err together
and count as n. The offsets ``o`` are this person's face; they are found from all frames by

3. ``o = argmin Σ_k F_k + Σ_p |o_p|² / 2 σ_o²``

Only training frames count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.observe.face_points import INDEPENDENT_POINTS, OFFSET_SIGMA, FacePoints, seen_face
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.subject.landmarks import FACE_LANDMARKS
from gva_mi.subject.video import Video

RIGID = [FACE_LANDMARKS.index(f"face_{number}") for number in range(27, 48)]  # nose and eyes
GAUSS_NEWTON_STEPS = 4  # chosen: offsets change by less than 0.1 mm in the last one
_HEAD = JOINTS.index("head")


@dataclass
class SeenFace:
    """P landmarks of the face in the T frames of a video.

    Attributes:
        joints: (55, 3) of the person at rest, metres.
        points: (P, 3) ``x``, metres.
        pixels: (T, P, 2).
        precision: (T, P) ``1 / σ²``; zero without a landmark, or outside the training frames.
        K: (T, 3, 3) of the cameras.
        T_camera_world: (T, 4, 4).
        offsets: (P, 3) ``o``, metres.
    """

    joints: Tensor
    points: Tensor
    pixels: Tensor
    precision: Tensor
    K: Tensor
    T_camera_world: Tensor
    offsets: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.offsets = torch.zeros_like(self.points)

    @staticmethod
    def of(video: Video, body: BodyModel) -> SeenFace | None:
        """Return the landmarks of a video; None if it has none, or the body has no face."""
        points = FacePoints.of(body)
        if video.landmarks is None or points is None:
            return None
        joints, pose = body.rest(video.shape).joints, video.pose
        K, T = (
            torch.from_numpy(np.stack([getattr(c, name) for c in video.cameras])).to(joints)
            for name in ("K", "T_camera_world")
        )
        head = T @ turn_joints(pose.rotations, joints, PARENTS, pose.transl)[1][:, _HEAD]
        A = head[:, :3, :3]
        found = seen_face(video.landmarks, A, A @ joints[_HEAD] + head[:, :3, 3], K[:, 0, 0])
        if found is None:
            return None
        pixels, precision = (x[:, RIGID] for x in found)
        trained = torch.zeros(len(K), 1)
        trained[list(video.splits.train)] = 1
        x = points.at_rest(video.shape.betas.double())[RIGID].to(joints)
        seen = SeenFace(joints, x, pixels, precision * trained, K, T)
        seen.fit_offsets(pose)
        return seen

    def frames_among(self, frames: range) -> list[int]:
        """Return those of some frames that show the face."""
        return [k for k in frames if bool(self.precision[k].any())]

    def losses(self, pose: Pose, frames: Sequence[int]) -> Tensor:
        """Return eq. 2 of B frames, given their poses: (B,) nats, differentiable."""
        frames = list(frames)
        square = self._errors(pose, frames)[0].square().sum(-1) * self.precision[frames]
        nats = (STUDENT_DOF + 2) / 2 * torch.log1p(square / STUDENT_DOF)
        return INDEPENDENT_POINTS * nats.mean(1)

    @torch.no_grad()
    def fit_offsets(self, pose: Pose) -> None:
        """Find the offsets (eq. 3) for the poses of all T frames."""
        frames = self.frames_among(range(len(self.K)))
        precision = self.precision[frames]
        prior = torch.eye(3) / OFFSET_SIGMA**2
        for _ in range(GAUSS_NEWTON_STEPS):
            errors, slopes = self._errors(pose[frames], frames)
            square = errors.square().sum(-1) * precision
            weights = precision * (STUDENT_DOF + 2) / (STUDENT_DOF + square)
            weights = weights * INDEPENDENT_POINTS / len(RIGID)
            normal = torch.einsum("kp,kpia,kpib->pab", weights, slopes, slopes) + prior
            pull = torch.einsum("kp,kpia,kpi->pa", weights, slopes, errors)
            pull = pull + self.offsets / OFFSET_SIGMA**2
            self.offsets = self.offsets - torch.linalg.solve(normal, pull)

    def _errors(self, pose: Pose, frames: list[int]) -> tuple[Tensor, Tensor]:
        """Return ``π(X) - u`` (B, P, 2) of eq. 1, and its slopes in the offsets (B, P, 2, 3)."""
        T = turn_joints(pose.rotations, self.joints, PARENTS, pose.transl)[1][:, _HEAD]
        T, K = self.T_camera_world[frames] @ T, self.K[frames]
        A, focal = T[:, None, :3, :3], K[:, None, [0, 1], [0, 1]]
        X = (self.points + self.offsets) @ T[:, :3, :3].mT + T[:, None, :3, 3]
        rays, z = X[..., :2] / X[..., 2:], X[..., 2:, None]
        slopes = (A[..., :2, :] - rays[..., None] * A[..., 2:, :]) * focal[..., None] / z
        return focal * rays + K[:, None, :2, 2] - self.pixels[frames], slopes
