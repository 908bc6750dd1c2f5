"""The poses that a fit sees: as they were given, or trained along with the avatar."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gva_mi.body.pose import Pose


class TrainedPoses(nn.Module):
    """The poses of the frames; where they are trained, rotations and translation of each frame.

    A parameter per frame: Adam leaves alone, momentum included, what has no gradient in a step.
    """

    def __init__(self, pose: Pose, trained: bool) -> None:
        super().__init__()
        self.given = pose
        self.frames = nn.ParameterList(_packed(pose).unbind() if trained else [])

    def forward(self, frame: int) -> Pose:
        """The pose of one frame."""
        given = self.given[frame]
        if not len(self.frames):
            return given
        return _unpacked(self.frames[frame][None], given.expression)

    def all(self) -> Pose:
        """The poses of all frames, as they are now."""
        if not len(self.frames):
            return self.given
        return _unpacked(torch.stack(list(self.frames)).detach(), self.given.expression)


def _packed(pose: Pose) -> Tensor:
    return torch.cat([pose.rotations.flatten(1), pose.transl], dim=1)  # (T, 168)


def _unpacked(rows: Tensor, expression: Tensor) -> Pose:
    rotations, transl = rows.split([165, 3], dim=1)
    return Pose.from_rotations(rotations.unflatten(1, (55, 3)), transl, expression)
