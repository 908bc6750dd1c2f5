"""What a viewer shows, as a value: two equal states are one picture.

A state says how an avatar differs from the motion that it is driven by:

    R_j' = R_j exp([r_j]×),    psi' = psi + e

so that a joint j that is turned by r_j is turned in every frame, about the axes it has there, and
what nobody touched stays as it is, to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import roma
import torch
from torch.nn.functional import pad

from gva_mi.body.pose import Pose

Mode = Literal["Gaussians", "mesh", "normals", "skeleton"]
SeenFrom = Literal["browser", "keyframes", "video"]
Angles = tuple[float, float, float]  # degrees about x, y and z: a rotation vector


@dataclass(frozen=True)
class State:
    """What is shown; where a browser looks from is an :class:`~gva_mi.viewer.eyes.Eye`."""

    frame: int = 0  # of the motion
    mode: Mode = "Gaussians"
    turned: tuple[tuple[int, Angles], ...] = ()  # joints by their numbers, and r_j
    joint: int = 0  # the one whose sliders are shown
    expression: tuple[float, ...] = ()  # e: as many coefficients as the avatar knows, or none
    background: tuple[int, int, int] = (255, 255, 255)  # 8-bit
    seen_from: SeenFrom = "browser"
    beside: bool = False  # the frame of the video to the left
    see_through: bool = False  # snapshots


def posed(motion: Pose, state: State) -> Pose:
    """The pose (of one frame) that a state asks for.

    Args:
        motion: T frames.
        state: what is shown.
    """
    pose = motion[state.frame]
    rotations, expression = pose.rotations, pose.expression
    for joint, angles in state.turned:
        if any(angles):
            r = torch.tensor(angles, dtype=rotations.dtype) * (math.pi / 180)
            rotations = rotations.clone()
            rotations[0, joint] = roma.rotvec_composition([rotations[0, joint], r])
    if any(state.expression):
        added = torch.tensor([state.expression], dtype=expression.dtype)
        width = max(added.shape[1], expression.shape[1])
        expression = sum(pad(x, (0, width - x.shape[1])) for x in (expression, added))
    return Pose(rotations, pose.transl, expression)


class Playback:
    """A motion that plays in a loop, whenever anybody looks."""

    def __init__(self) -> None:
        self._at = 0.0  # frames, with what is left over from the last look
        self._shown, self._then = -1, 0.0

    def advance(self, frame: int, now: float, fps: float, count: int) -> int:
        """The frame to be shown.

        Args:
            frame: that is shown; where it is not the one of the last call, it plays on from there.
            now: seconds on any clock.
            fps: frames a second.
            count: frames of the motion.
        """
        if frame != self._shown:
            self._at, self._then = float(frame), now
        self._at = (self._at + (now - self._then) * fps) % count
        self._then, self._shown = now, min(int(self._at), count - 1)
        return self._shown

    def stop(self) -> None:
        """Forget when the last look was."""
        self._shown = -1
