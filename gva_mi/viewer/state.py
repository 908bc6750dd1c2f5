"""The state of a viewer as a value: equal states give equal pictures.

A state holds how an avatar differs from the motion that drives it:

    R_j' = R_j exp([r_j]×),    psi' = psi + e

So joint j is turned by r_j in every frame, about its own axes there. Joints and expressions that
were not changed keep their bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch.nn.functional import pad

from gva_mi.body.pose import Pose
from gva_mi.body.so3 import compose

Mode = Literal["Gaussians", "mesh", "normals", "skeleton"]
SeenFrom = Literal["browser", "keyframes", "video"]
Angles = tuple[float, float, float]  # degrees about x, y and z: a rotation vector


@dataclass(frozen=True)
class State:
    """Everything that defines a picture, except for the browser's camera."""

    frame: int = 0  # of the motion
    mode: Mode = "Gaussians"
    turned: tuple[tuple[int, Angles], ...] = ()  # joint numbers and r_j
    joint: int = 0  # whose sliders are shown
    expression: tuple[float, ...] = ()  # e: as many coefficients as the avatar has, or none
    background: tuple[int, int, int] = (255, 255, 255)  # 8-bit
    seen_from: SeenFrom = "browser"
    beside: bool = False  # the frame of the video to the left
    transparent: bool = False  # background of snapshots


def posed(motion: Pose, state: State) -> Pose:
    """Return the motion's pose of one frame with the state's changes applied."""
    pose = motion[state.frame]
    rotations, expression = pose.rotations, pose.expression
    for joint, angles in state.turned:
        if any(angles):
            r = torch.tensor(angles, dtype=rotations.dtype) * (math.pi / 180)
            rotations = rotations.clone()
            rotations[0, joint] = compose(rotations[0, joint], r)
    if any(state.expression):
        added = torch.tensor([state.expression], dtype=expression.dtype)
        width = max(added.shape[1], expression.shape[1])
        expression = sum(pad(x, (0, width - x.shape[1])) for x in (expression, added))
    return Pose(rotations, pose.transl, expression)


class Playback:
    """A motion that plays in a loop by the clock."""

    def __init__(self) -> None:
        self._at = 0.0  # frames, with a fraction
        self._shown, self._then = -1, 0.0

    def advance(self, frame: int, now: float, fps: float, count: int) -> int:
        """Return the frame, of ``count``, to show at the time ``now`` (seconds of any clock).

        If the ``frame`` shown is not the last call's, the motion plays on from there.
        """
        if frame != self._shown:
            self._at, self._then = float(frame), now
        self._at = (self._at + (now - self._then) * fps) % count
        self._then, self._shown = now, min(int(self._at), count - 1)
        return self._shown

    def stop(self) -> None:
        """Forget the time of the last call."""
        self._shown = -1
