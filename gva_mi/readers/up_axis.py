"""Find the up axis of a motion, and turn the motion so that y is up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import composed, to_matrices
from gva_mi.subject.silhouettes import joints_in_world

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
UP_AXES: tuple[Axis, ...] = get_args(Axis)
# All chosen.
LEAN_NOTE_DEGREES = 20  # a person who leans by more from the up axis is worth a note
LYING_DEGREES = 60  # a person who leans by more lies, or stands on the head: worth a doubt
_UP_COSINE = 0.7  # of the angle between the up axis and the direction from feet to head: 45 degrees
_BEGINNING_SECONDS = 0.5  # people begin upright, even if they lie down, swim or do handstands later
_FLOOR_TOLERANCE = 0.15  # metres that the lowest joint may drift more than along the evenest axis
_QUARTER_TURNS_TO_Y = {  # axis-angle, in quarter turns, of the rotation that turns an axis to y
    "x": (0, 0, 1), "-x": (0, 0, -1), "y": (0, 0, 0), "-y": (2, 0, 0), "z": (-1, 0, 0),
    "-z": (1, 0, 0),
}  # fmt: skip


@dataclass(frozen=True)
class Upward:
    """The direction from a person's feet to the head, and how even a floor would be."""

    begins: np.ndarray  # (3,) unit vector from the feet to the head in the first frames
    mean: np.ndarray  # (3,) of all frames
    drifts: Mapping[
        str, float
    ]  # by axis of UP_AXES: how far the lowest joint rises and falls, metres

    @staticmethod
    def of(rotations: np.ndarray, places: np.ndarray, joints: np.ndarray, rate: float) -> Upward:
        """Measure rotations (T, 55, 3) and pelvises (T, 3) of ``rate`` frames a second.

        ``joints`` are (55, 3) at rest of any body.
        """
        seen = joints_in_world(rotations, places - joints[0], joints)
        at = lambda name: seen[:, JOINTS.index(name)]
        upward = unit(at("head") - (at("left_ankle") + at("right_ankle")) / 2)
        first = max(1, round(_BEGINNING_SECONDS * rate))
        lows = {up: (seen @ axis_of(up)).min(1) for up in UP_AXES}
        drifts = {up: float(np.subtract(*np.percentile(x, (95, 5)))) for up, x in lows.items()}
        return Upward(unit(upward[:first].mean(0)), unit(upward.mean(0)), drifts)

    def axis(self) -> str | None:
        """Return the axis of :data:`UP_AXES` that is up; None if none is clear (a lying person).

        It is the axis along which the person begins upright, among axes with an even floor, then
        among all axes; otherwise the one along which the person is upright on average.
        """
        least = min(self.drifts.values()) + _FLOOR_TOLERANCE
        floors = [up for up in UP_AXES if self.drifts[up] <= least]
        for ups, upward in ((floors, self.begins), (UP_AXES, self.begins), (UP_AXES, self.mean)):
            best = max(ups, key=lambda up: float(upward @ axis_of(up)))
            if upward @ axis_of(best) >= _UP_COSINE:
                return best
        return None

    def lean(self, up: str) -> float:
        """Return the angle, degrees, between an axis and the person, at first or on average."""
        cosine = max(float(x @ axis_of(up)) for x in (self.begins, self.mean))
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def axis_of(up: str) -> np.ndarray:
    """Return the unit vector (3,) of an axis of :data:`UP_AXES`."""
    return np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)


def unit(x: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) of length 1; zero stays zero."""
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)


def upright(rotations: np.ndarray, places: np.ndarray, up: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotate the world of rotations (T, 55, 3) and pelvises (T, 3) so that ``up`` becomes y.

    ``up`` is one of :data:`UP_AXES`.
    """
    turn = turn_to_y(up)
    rotations = rotations.copy()
    rotations[:, 0] = composed(turn, rotations[:, 0])
    return rotations, places @ to_matrices(turn).T


def turn_to_y(up: str) -> np.ndarray:
    """Return the rotation (3,), axis-angle, that turns an axis of :data:`UP_AXES` to y."""
    return np.array(_QUARTER_TURNS_TO_Y[up], np.float64) * np.pi / 2
