"""Landmarks hold poses while they are trained along with an avatar.

Pictures move a part only toward what the avatar has already learned. While the avatar's face is
blurred, each side of a turn may pull the head its own way, and the avatar gets two faces; where an
arm touches a dress, each may look like the other. The landmarks of the video still show where these
parts are. They are those of the refinement (:mod:`gva_mi.refine.landmark_evidence`). Only training
frames count.

The offsets ``o`` are how this person differs from the average one. They are found from all frames k
by

1. ``o = argmin Σ_k L_k + E(o)``

The network may find a face in the wrong place. The refinement, which also sees masks and motion,
does not follow it there. So a face counts only if, under the given pose, its points p have

2. ``mean_p |r_kp|² <= CONTRADICTED``
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.refine.landmark_evidence import SeenLandmarks
from gva_mi.subject.landmarks import FACE_LANDMARKS
from gva_mi.subject.video import Video

# Of eq. 2. Chosen: heads that are off by 15 degrees reach it, and those of four rendered videos 6.
# A face that the network found in the wrong place had 170.
CONTRADICTED = 36.0
GAUSS_NEWTON_STEPS = 4  # chosen: offsets change by less than 0.1 mm in the last one


@dataclass
class TrainingLandmarks:
    """The landmarks of a video's training frames, as evidence of poses.

    Attributes:
        evidence: P landmarks in all T frames; of test frames their ``scale`` is zero.
        shape: of the person.
        joints: (55, 3) of the person at rest, metres.
        offsets: (P, 3) ``o``, metres.
    """

    evidence: SeenLandmarks
    shape: Shape
    joints: Tensor
    offsets: Tensor = field(init=False)

    def __post_init__(self) -> None:
        self.offsets = torch.zeros_like(self.evidence.rig.rest)

    @staticmethod
    def of(video: Video, body: BodyModel) -> TrainingLandmarks | None:
        """Return the landmarks of a video, with offsets by its poses; None if it has none."""
        if video.landmarks is None:
            return None
        seen = SeenLandmarks.of(video.landmarks, body, video.cameras, video.pose, video.shape)
        trained = torch.zeros(len(video.pose), 1, 1, 1)
        trained[list(video.splits.train)] = 1
        seen = replace(seen, scale=seen.scale * trained)
        found = TrainingLandmarks(seen, video.shape, body.rest(video.shape).joints)
        found.fit_offsets(video.pose)
        found._drop_contradicted_faces(video.pose)
        found.fit_offsets(video.pose)
        return found

    def frames_among(self, frames: range) -> list[int]:
        """Return the given frames that show a landmark."""
        return [k for k in frames if bool(self.evidence.scale[k].any())]

    def losses(self, pose: Pose, frames: Sequence[int]) -> Tensor:
        """Return the losses of B frames, given their poses: (B,) nats, differentiable."""
        return self.evidence.losses(frames, *self._person(pose))

    @torch.no_grad()
    def fit_offsets(self, pose: Pose) -> None:
        """Find the offsets (eq. 1) for the poses of all T frames, by Gauss-Newton steps."""
        frames = self.frames_among(range(len(self.evidence.K)))
        precision = self.evidence.rig.offset_spread[:, None] ** -2
        for _ in range(GAUSS_NEWTON_STEPS):
            person = self._person(pose[frames])
            r, slopes = self.evidence.errors(frames, *person), self.evidence.slopes(frames, *person)
            weights = (STUDENT_DOF + 2) / (STUDENT_DOF + r.square().sum(-1)) * self.evidence.counts
            normal = torch.einsum("kp,kpia,kpib->pab", weights, slopes, slopes)
            normal = normal + precision[..., None] * torch.eye(3)
            pull = torch.einsum("kp,kpia,kpi->pa", weights, slopes, r) + precision * self.offsets
            self.offsets = self.offsets - torch.linalg.solve(normal, pull)

    @torch.no_grad()
    def _drop_contradicted_faces(self, pose: Pose) -> None:
        """Drop the faces that miss eq. 2 for the poses of all T frames."""
        seen, frames = self.evidence, range(len(self.evidence.K))
        face = torch.tensor([name in FACE_LANDMARKS for name in seen.rig.names])
        square = seen.errors(frames, *self._person(pose)).square().sum(-1)
        wrong = (square * face).sum(1) > CONTRADICTED * face.sum()
        kept = ~(wrong[:, None] & face)
        self.evidence = replace(seen, scale=seen.scale * kept[..., None, None])

    def _person(self, pose: Pose) -> tuple[Tensor, Shape, Tensor]:
        """Return the person in B poses: its joints (B, 55, 4, 4), shape and offsets."""
        T_world_rest = turn_joints(pose.rotations, self.joints, PARENTS, pose.transl)[1]
        return T_world_rest, self.shape, self.offsets
