"""The poses that a fit uses: as they were given, or trained along with the avatar.

Training corrects the errors that the refinement by masks and normals left. A test frame must not be
trained on, and yet its pose has errors of the same kind: slow ones, such as a depth that is wrong
for seconds. So its correction is interpolated between its neighbours in time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from gva_mi.body.pose import Pose


class TrainedPoses(nn.Module):
    """The poses of all frames.

    Attributes:
        given: the poses as they were given.
        frames: where poses are trained, a parameter (168,) per frame: rotations (55, 3), row by
            row, and translation. Adam leaves a parameter without a gradient alone, with its
            momentum, and a step shows few frames.
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

    def all(self, trained: Sequence[int]) -> Pose:
        """The poses of all frames, trained or interpolated.

        Args:
            trained: the frames that were trained on; all others get interpolated corrections.
        """
        if not len(self.frames):
            return self.given
        given = _packed(self.given)
        correction = (torch.stack(list(self.frames)).detach() - given).numpy()
        time, seen = np.arange(len(given)), sorted(trained)
        columns = [np.interp(time, seen, column) for column in correction[seen].T]
        between = torch.from_numpy(np.stack(columns, axis=1)).to(given.dtype)
        return _unpacked(given + between, self.given.expression)


def _packed(pose: Pose) -> Tensor:
    """Rotations and translation of each frame as a row, (T, 168)."""
    return torch.cat([pose.rotations.flatten(1), pose.transl], dim=1)


def _unpacked(rows: Tensor, expression: Tensor) -> Pose:
    """The pose that :func:`_packed` made rows of, with its expression."""
    rotations, transl = rows.split([165, 3], dim=1)
    return Pose(rotations.unflatten(1, (55, 3)), transl, expression)
