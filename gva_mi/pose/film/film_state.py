"""What stage 1 of a film solves for, and which of it one problem may change.

All is in the camera's axes: x right, y down, z away from the camera, which stands at the origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.so3 import compose


@dataclass(frozen=True)
class FilmState:
    """Poses of T frames, and what all frames share; float64.

    Attributes:
        rotations: (T, 55, 3) axis-angle; the root's relative to the camera's axes.
        place: (T, 3) of the root joint, metres.
        betas: (B,).
        focal: the logarithm of a factor on the camera's focal length, ().
        up: (2,) the world's upward direction is that of ``(up_0, -1, up_1)``.
        floor: () height of the camera above the floor, metres.
        offsets: (P, 3) constant offsets of the landmarks, metres.
        habits: (Q,) constant offsets of the angles that anatomy holds at zero, radians.
    """

    rotations: Tensor
    place: Tensor
    betas: Tensor
    focal: Tensor
    up: Tensor
    floor: Tensor
    offsets: Tensor
    habits: Tensor

    def upward(self) -> tuple[Tensor, Tensor]:
        """Return the unit vector upward (3,), and its derivative (3, 2) by ``up``."""
        n = torch.stack([self.up[0], -torch.ones_like(self.up[0]), self.up[1]])
        length, unit = n.norm(), n / n.norm()
        across = torch.eye(3, dtype=n.dtype) - unit[:, None] * unit
        return unit, across[:, [0, 2]] / length


@dataclass(frozen=True)
class Free:
    """The unknowns of one problem, as columns: those of a frame, then those that frames share.

    Shared columns are counted from the first of them on.

    Attributes:
        joints: that may turn; with the root (first) the person may also travel.
        betas: number of them.
        camera: whether focal length, upward direction and floor are unknown.
        offsets: landmarks whose offsets are unknown.
        habits: angles whose offsets are unknown.
    """

    joints: Sequence[int]
    betas: int = 0
    camera: bool = False
    offsets: Sequence[int] = ()
    habits: Sequence[int] = ()

    @property
    def travels(self) -> bool:
        return 0 in self.joints

    @property
    def per_frame(self) -> int:
        """F, columns of a frame: place, if the person travels, then joints."""
        return 3 * (len(self.joints) + self.travels)

    @property
    def shared(self) -> int:
        """S."""
        return self.betas + 4 * self.camera + 3 * len(self.offsets) + len(self.habits)

    @property
    def first_of_camera(self) -> int:
        """Shared column of the focal length; those of up and the floor follow."""
        return self.betas

    @property
    def first_of_offsets(self) -> int:
        return self.first_of_camera + 4 * self.camera

    @property
    def first_of_habits(self) -> int:
        return self.first_of_offsets + 3 * len(self.offsets)

    def moved(self, state: FilmState, step: Tensor, shared: Tensor) -> FilmState:
        """Apply a step (T, F) and (S,)."""
        turns = step.unflatten(1, (-1, 3))
        place, rotations = state.place, state.rotations.clone()
        if self.travels:
            place, turns = place + turns[:, 0], turns[:, 1:]
            rotations[:, 0] = compose(rotations[:, 0], turns[:, 0])
            rotations[:, list(self.joints[1:])] += turns[:, 1:]
        else:
            rotations[:, list(self.joints)] += turns
        camera, habits = self.first_of_camera, self.first_of_habits
        betas, moved, held = state.betas.clone(), state.offsets.clone(), state.habits.clone()
        betas[: self.betas] += shared[: self.betas]
        moved[list(self.offsets)] += shared[self.first_of_offsets : habits].view(-1, 3)
        held[list(self.habits)] += shared[habits:]
        found = replace(
            state, rotations=rotations, place=place, betas=betas, offsets=moved, habits=held
        )
        if not self.camera:
            return found
        focal, up, floor = shared[camera], shared[camera + 1 : camera + 3], shared[camera + 3]
        return replace(
            found, focal=state.focal + focal, up=state.up + up, floor=state.floor + floor
        )
