"""What stage 1 solves for: the unknowns of a video, and which of them one problem moves.

:class:`Stage1State` holds the values. :class:`Unknowns` says which of them are free in one problem,
and lists them as columns of its normal equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.so3 import compose


@dataclass(frozen=True)
class Stage1State:
    """Poses of T frames, and the unknowns that all frames share; float64.

    Attributes:
        rotations: (T, 55, 3) axis-angle; the root is rotated relative to the camera's axes.
        pelvis_position: (T, 3) of the root joint in the camera's axes, metres.
        betas: (B,) of the shape.
        log_focal_scale: () logarithm of a factor on the camera's focal length.
        up: (2,) ``(up_0, -1, up_1)`` points up in the camera's axes.
        floor: () height of the camera above the floor, metres.
        offsets: (P, 3) constant offsets of the landmarks, metres.
        angle_offsets: (Q,) constant offsets of the angles of :mod:`gva_mi.prior.anatomy`, radians.
    """

    rotations: Tensor
    pelvis_position: Tensor
    betas: Tensor
    log_focal_scale: Tensor
    up: Tensor
    floor: Tensor
    offsets: Tensor
    angle_offsets: Tensor

    def upward(self) -> tuple[Tensor, Tensor]:
        """Return the unit vector upward (3,), and its derivative (3, 2) with respect to ``up``."""
        n = torch.stack([self.up[0], -torch.ones_like(self.up[0]), self.up[1]])
        length, unit = n.norm(), n / n.norm()
        across = torch.eye(3, dtype=n.dtype) - unit[:, None] * unit
        return unit, across[:, [0, 2]] / length


@dataclass(frozen=True)
class Unknowns:
    """The free unknowns of one problem, as columns: F of each frame, then S that frames share.

    Indices of shared columns count from the first shared column.

    Attributes:
        joints: that may turn; with the root (first) the person may also travel.
        betas: number of free betas.
        camera: whether focal length, upward direction and floor are free.
        offsets: landmarks whose offsets are free.
        angle_offsets: angles whose offsets are free.
    """

    joints: Sequence[int]
    betas: int = 0
    camera: bool = False
    offsets: Sequence[int] = ()
    angle_offsets: Sequence[int] = ()

    @property
    def travels(self) -> bool:
        """Whether the pelvis position is free."""
        return 0 in self.joints

    @property
    def per_frame(self) -> int:
        """``F``, columns of a frame: the pelvis position, if it is free, then the joints."""
        return 3 * (len(self.joints) + self.travels)

    @property
    def shared(self) -> int:
        """``S``, columns that frames share: betas, camera, offsets, offsets of angles."""
        return self.betas + 4 * self.camera + 3 * len(self.offsets) + len(self.angle_offsets)

    @property
    def camera_column(self) -> int:
        """Shared column of the focal length; up (2) and the floor follow."""
        return self.betas

    @property
    def offsets_column(self) -> int:
        """First shared column of the landmarks' offsets."""
        return self.camera_column + 4 * self.camera

    @property
    def angle_offsets_column(self) -> int:
        """First shared column of the angles' offsets."""
        return self.offsets_column + 3 * len(self.offsets)

    def moved(self, state: Stage1State, step: Tensor, shared: Tensor) -> Stage1State:
        """Return a state after a step: (T, F) of the frames, and ``shared`` (S,)."""
        turns = step.unflatten(1, (-1, 3))
        pelvis_position, rotations = state.pelvis_position, state.rotations.clone()
        if self.travels:
            pelvis_position, turns = pelvis_position + turns[:, 0], turns[:, 1:]
            rotations[:, 0] = compose(rotations[:, 0], turns[:, 0])
            rotations[:, list(self.joints[1:])] += turns[:, 1:]
        else:
            rotations[:, list(self.joints)] += turns
        camera, offsets = self.camera_column, state.offsets.clone()
        betas, angles = state.betas.clone(), state.angle_offsets.clone()
        betas[: self.betas] += shared[: self.betas]
        of_offsets = slice(self.offsets_column, self.angle_offsets_column)
        offsets[list(self.offsets)] += shared[of_offsets].view(-1, 3)
        angles[list(self.angle_offsets)] += shared[self.angle_offsets_column :]
        moved_state = replace(
            state,
            rotations=rotations,
            pelvis_position=pelvis_position,
            betas=betas,
            offsets=offsets,
            angle_offsets=angles,
        )
        if not self.camera:
            return moved_state
        focal, up, floor = shared[camera], shared[camera + 1 : camera + 3], shared[camera + 3]
        return replace(
            moved_state,
            log_focal_scale=state.log_focal_scale + focal,
            up=state.up + up,
            floor=state.floor + floor,
        )
