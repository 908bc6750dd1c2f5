"""Stage-1 poses of chosen frames, and the rotations between the camera's axes and the joints'."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose
from gva_mi.body.so3 import compose, turns_between
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Stage1Poses:
    """Stage-1 poses of n frames, which are corrected in the camera's axes.

    Attributes:
        times: (n,) frame numbers, ascending.
        pose: of the n frames.
        R_joint_camera: (n, J, 3, 3) rotate a vector from the camera's axes to a joint's axes.
        R_camera_world: (3, 3).
    """

    times: Tensor
    pose: Pose
    R_joint_camera: Tensor
    R_camera_world: Tensor

    @staticmethod
    def of(pose: Pose, frames: Sequence[int], camera: Camera) -> Stage1Poses:
        """Take some frames of a video by their numbers, ascending.

        If cameras differ, the axes of one frame's ``camera`` serve for all.
        """
        chosen = pose[list(frames)]
        R_camera_world = torch.from_numpy(camera.T_camera_world[:3, :3].copy()).float()
        at_origin = torch.zeros(1, len(PARENTS), 3)
        T_world_rest = turn_joints(chosen.rotations, at_origin, PARENTS, chosen.transl)[1]
        R_joint_camera = torch.einsum("kjai,ca->kjic", T_world_rest[..., :3, :3], R_camera_world)
        return Stage1Poses(torch.tensor(list(frames)), chosen, R_joint_camera, R_camera_world)

    @property
    def turn_amount(self) -> float:
        """Amount by which the person turns: 1 for a full turn, 0.6 for half, 0 for none."""
        # Without a turn the mean rotation has square norm 3, after a full one a third of it.
        stays = self.R_joint_camera[:, 0].mean(0).square().sum() / 3
        return float((1.5 * (1 - stays)).clamp(0, 1))

    def corrected(self, which: Sequence[int], turns: Tensor, moves: Tensor) -> Pose:
        """Correct r of the n frames.

        Args:
            which: the r frames, by index.
            turns: (r, J, 3) in the camera's axes, radians.
            moves: (r, 3) in the camera's axes, metres.
        """
        which = list(which)
        local = self.to_joint_axes(turns, which)
        rotations = compose(self.pose.rotations[which], local)
        transl = self.pose.transl[which] + moves @ self.R_camera_world
        return Pose(rotations, transl, self.pose.expression[which])

    def to_joint_axes(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the camera's axes to the joints' axes."""
        return (self.R_joint_camera[which] @ turns[..., None])[..., 0]

    def to_camera_axes(self, turns: Tensor, which: Sequence[int] | slice = slice(None)) -> Tensor:
        """Rotate vectors (r, J, 3) from the joints' axes to the camera's axes."""
        return (self.R_joint_camera[which].mT @ turns[..., None])[..., 0]

    def steps(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Return how poses of the n frames change from frame to frame.

        Returns:
            Turns (n - 1, J, 3) in the joints' axes, and shifts (n - 1, 3) in the camera's axes.
        """
        turns = turns_between(pose.rotations[:-1], pose.rotations[1:])
        return turns, pose.transl.diff(dim=0) @ self.R_camera_world.T
