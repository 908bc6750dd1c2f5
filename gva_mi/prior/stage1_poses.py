"""Stage-1 poses of some frames, and the camera's axes in which they are corrected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose
from gva_mi.body.so3 import compose
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Stage1:
    """Poses of n frames, and the camera's axes relative to their joints."""

    times: Tensor  # (n,) numbers of the frames, ascending
    pose: Pose  # n frames
    # (n, J, 3, 3) rotates a vector from the camera's axes to those of a joint
    R_joint_camera: Tensor
    R_camera_world: Tensor  # (3, 3)

    @staticmethod
    def of(pose: Pose, frames: Sequence[int], camera: Camera) -> Stage1:
        """Take some frames of a video by their numbers, ascending.

        If cameras differ, the axes are those of the ``camera`` of one frame.
        """
        some = pose[list(frames)]
        R_camera_world = torch.from_numpy(camera.T_camera_world[:3, :3].copy()).float()
        nowhere = torch.zeros(1, len(PARENTS), 3)
        T_world_rest = turn_joints(some.rotations, nowhere, PARENTS, some.transl)[1]
        R_joint_camera = torch.einsum("kjai,ca->kjic", T_world_rest[..., :3, :3], R_camera_world)
        return Stage1(torch.tensor(list(frames)), some, R_joint_camera, R_camera_world)

    @property
    def turned(self) -> float:
        """Amount by which the person turns: 1 for a full turn, 0.6 for half, 0 for none."""
        # Without a turn the mean rotation has square norm 3, after a full one a third of it.
        stays = self.R_joint_camera[:, 0].mean(0).square().sum() / 3
        return float((1.5 * (1 - stays)).clamp(0, 1))

    def corrected(self, which: Sequence[int], turns: Tensor, moves: Tensor) -> Pose:
        """Correct r of the n frames, given by index, in the camera's axes.

        The turns are (r, J, 3) radians, the moves (r, 3) metres.
        """
        which = list(which)
        local = self.in_joints(turns, which)
        rotations = compose(self.pose.rotations[which], local)
        transl = self.pose.transl[which] + moves @ self.R_camera_world
        return Pose(rotations, transl, self.pose.expression[which])

    def in_joints(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the camera's axes to those of the joints."""
        return (self.R_joint_camera[which] @ turns[..., None])[..., 0]

    def in_camera(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the axes of the joints to those of the camera."""
        return (self.R_joint_camera[which].mT @ turns[..., None])[..., 0]

    def steps(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return how poses of the n frames change from frame to frame.

        Returns:
            Turns (n - 1, J, 3) in the axes of the joints, shifts (n - 1, 3) in the camera's.
        """
        turns = turns_between(pose.rotations[:-1], pose.rotations[1:])
        return turns, pose.transl.diff(dim=0) @ self.R_camera_world.T


def turns_between(before: Tensor, after: Tensor) -> Tensor:
    """Return the turns ``log(Rᵀ R')`` (..., 3) between rotations ``R`` and ``R'``, axis-angle."""
    import roma  # here: it imports torch's compiler, which takes longer than importing torch

    return roma.rotvec_composition([-before, after])
