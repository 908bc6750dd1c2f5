"""Landmarks hold poses while they are trained along with an avatar.

Pictures move a part only toward what the avatar has already learned. While the avatar's face is
blurred, each side of a turn may pull the head its own way, and the avatar gets two faces; where an
arm touches a dress, each may look like the other. The landmarks ``u`` of the video still show where
these parts are. Landmark p moves with a joint j, and in frame k it is at

1. ``X_kp = A_kj (x_p + o_p) + a_kj``
2. ``r_kp = S_kp (π_k(X_kp) - u_kp) / σ_kp``
3. ``F_k = Σ_p n_p (ν + 2) / 2 · log(1 + |r_kp|² / ν)``

with the joint's rotation ``A`` and place ``a``, the camera's projection ``π``, and standard
deviation ``σ`` and whitening ``S`` of the network's errors. Errors last for some frames, and points
of one part err together, so each point counts as ``n`` independent ones. The offsets ``o`` are how
this person differs from the average one. They are found from all frames by

4. ``o = argmin Σ_k F_k + Σ_p |o_p|² / 2 σ_o,p²``

These are the landmarks of the body and hands that the refinement used, too
(:mod:`gva_mi.refine.landmark_evidence`). The face has those of eyes and nose
(:mod:`gva_mi.observe.face_points`), which move with the head alone and are far more exact. But the
network may find a face in the wrong place. The refinement, which also sees masks and motion, does
not follow it there. So a face counts only if, under the given pose,

5. ``mean_p |r_kp|² <= CONTRADICTED``

Only training frames count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import sqrt
from gva_mi.observe.face_points import INDEPENDENT_POINTS, OFFSET_SIGMA, FacePoints, seen_face
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.refine.landmark_evidence import CORRELATED_FRAMES, SeenLandmarks
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS
from gva_mi.subject.video import Video

RIGID = [FACE_LANDMARKS.index(f"face_{number}") for number in range(27, 48)]  # nose and eyes
ROUGH_FACE = BODY_LANDMARKS[:11]  # of the body's network, which the face's network outdoes
# Of eq. 5. Chosen: heads that are off by 15 degrees reach it, and those of four rendered videos 6.
# A face that the network found in the wrong place had 170.
CONTRADICTED = 36.0
GAUSS_NEWTON_STEPS = 4  # chosen: offsets change by less than 0.1 mm in the last one
_HEAD = JOINTS.index("head")


@dataclass(frozen=True)
class _RiggedPoints:
    """P landmarks in T frames.

    Attributes:
        joints: (P,) ``j``, that they move with.
        rest: (P, 3) ``x`` of this person, metres.
        spread: (P,) ``σ_o``, metres.
        counts: (P,) ``n``.
        pixels: (T, P, 2) ``u``; zero without a landmark.
        scale: (T, P, 2, 2) ``S / σ``; zero without a landmark.
    """

    joints: Tensor
    rest: Tensor
    spread: Tensor
    counts: Tensor
    pixels: Tensor
    scale: Tensor

    @staticmethod
    def of_face(video: Video, body: BodyModel, seen: SeenLandmarks) -> _RiggedPoints | None:
        """Return nose and eyes; None if no network looked for them, or the body has no face."""
        points = FacePoints.of(body)
        if points is None:
            return None
        joints = body.rest(video.shape).joints
        T = turn_joints(video.pose.rotations, joints, PARENTS, video.pose.transl)[1][:, _HEAD]
        T = seen.T_camera_world @ T
        a = T[:, :3, :3] @ joints[_HEAD] + T[:, :3, 3]
        found = seen_face(video.landmarks, T[:, :3, :3], a, seen.K[:, 0, 0])
        if found is None:
            return None
        pixels, precision = (x[:, RIGID] for x in found)
        one = torch.ones(len(RIGID))
        return _RiggedPoints(
            one.long() * _HEAD,
            points.at_rest(video.shape.betas.double())[RIGID].to(joints),
            one * OFFSET_SIGMA,
            one * INDEPENDENT_POINTS / len(RIGID),
            pixels,
            sqrt(precision)[..., None, None] * torch.eye(2),
        )

    @staticmethod
    def of_body(video: Video, seen: SeenLandmarks) -> _RiggedPoints:
        """Return the landmarks of body and hands."""
        rough = torch.tensor([name in ROUGH_FACE for name in seen.rig.names])
        return _RiggedPoints(
            seen.rig.joints,
            seen.rig.at_rest(video.shape.betas),
            seen.rig.offset_spread,
            torch.where(rough, 0, seen.point_weights / CORRELATED_FRAMES),
            seen.pixels,
            seen.precision[..., None, None] * seen.whitening,
        )

    def and_those(self, other: _RiggedPoints | None) -> _RiggedPoints:
        """Append other landmarks of the same frames."""
        if other is None:
            return self
        pairs = zip(vars(self).items(), vars(other).values(), strict=True)
        of_frames = ("pixels", "scale")
        return _RiggedPoints(**{k: torch.cat([x, y], int(k in of_frames)) for (k, x), y in pairs})


@dataclass
class TrainingLandmarks:
    """The landmarks of a video's training frames, as evidence of poses.

    Attributes:
        points: of all T frames; of test frames their ``scale`` is zero.
        joints: (55, 3) of the person at rest, metres.
        K: (T, 3, 3) of the cameras.
        T_camera_world: (T, 4, 4).
        offsets: (P, 3) ``o``, metres.
    """

    points: _RiggedPoints
    joints: Tensor
    K: Tensor
    T_camera_world: Tensor
    offsets: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.offsets = torch.zeros_like(self.points.rest)

    @staticmethod
    def of(video: Video, body: BodyModel) -> TrainingLandmarks | None:
        """Return the landmarks of a video, with offsets by its poses; None if it has none."""
        if video.landmarks is None:
            return None
        given = video.landmarks, body, video.cameras, video.pose, video.shape
        seen = SeenLandmarks.of(*given)
        points = _RiggedPoints.of_body(video, seen).and_those(
            _RiggedPoints.of_face(video, body, seen)
        )
        trained = torch.zeros(len(video.pose), 1, 1, 1)
        trained[list(video.splits.train)] = 1
        points = replace(points, scale=points.scale * trained)
        joints = body.rest(video.shape).joints
        found = TrainingLandmarks(points, joints, seen.K, seen.T_camera_world)
        found.fit_offsets(video.pose)
        found._drop_contradicted_faces(video.pose)
        found.fit_offsets(video.pose)
        return found

    def frames_among(self, frames: range) -> list[int]:
        """Return the given frames that show a landmark."""
        return [k for k in frames if bool(self.points.scale[k].any())]

    def losses(self, pose: Pose, frames: Sequence[int]) -> Tensor:
        """Return eq. 3 of B frames, given their poses: (B,) nats, differentiable."""
        square = self._errors(pose, list(frames))[0].square().sum(-1)
        nats = (STUDENT_DOF + 2) / 2 * torch.log1p(square / STUDENT_DOF)
        return (self.points.counts * nats).sum(1)

    @torch.no_grad()
    def fit_offsets(self, pose: Pose) -> None:
        """Find the offsets (eq. 4) for the poses of all T frames."""
        frames = self.frames_among(range(len(self.K)))
        precision = self.points.spread[:, None] ** -2
        for _ in range(GAUSS_NEWTON_STEPS):
            r, slopes = self._errors(pose[frames], frames)
            weights = (STUDENT_DOF + 2) / (STUDENT_DOF + r.square().sum(-1)) * self.points.counts
            normal = torch.einsum("kp,kpia,kpib->pab", weights, slopes, slopes)
            normal = normal + precision[..., None] * torch.eye(3)
            pull = torch.einsum("kp,kpia,kpi->pa", weights, slopes, r) + precision * self.offsets
            self.offsets = self.offsets - torch.linalg.solve(normal, pull)

    @torch.no_grad()
    def _drop_contradicted_faces(self, pose: Pose) -> None:
        """Drop the faces that miss eq. 5 for the poses of all T frames."""
        face = (self.points.joints == _HEAD) & (self.points.counts > 0)
        square = self._errors(pose, list(range(len(self.K))))[0].square().sum(-1)
        wrong = (square * face).sum(1) > CONTRADICTED * face.sum()
        kept = ~(wrong[:, None] & face)
        self.points = replace(self.points, scale=self.points.scale * kept[..., None, None])

    def _errors(self, pose: Pose, frames: list[int]) -> tuple[Tensor, Tensor]:
        """Return eq. 2, (B, P, 2), and its slopes in the offsets (B, P, 2, 3)."""
        points, K = self.points, self.K[frames]
        T = turn_joints(pose.rotations, self.joints, PARENTS, pose.transl)[1][:, points.joints]
        T = self.T_camera_world[frames][:, None] @ T
        A, focal = T[..., :3, :3], K[:, None, [0, 1], [0, 1]]
        X = (A @ (points.rest + self.offsets)[..., None])[..., 0] + T[..., :3, 3]
        rays, z = X[..., :2] / X[..., 2:], X[..., 2:, None]
        slopes = (A[..., :2, :] - rays[..., None] * A[..., 2:, :]) * focal[..., None] / z
        off = focal * rays + K[:, None, :2, 2] - points.pixels[frames]
        scale = points.scale[frames]
        return (scale @ off[..., None])[..., 0], scale @ slopes
