"""Hand gestures as rotations of SMPL-X's joints relative to the flat hand.

A finger has one curl c; its joints bend by 1.35 c, 1.75 c and 1.15 c about the hand's z axis, so
that c = 1 brings the tip to the palm. Fingers spread about the y axis. The thumb has no hinge and
is given joint by joint.

All angles are chosen here, by looking at the built-in body.

Example:
    >>> from gva_mi.body.pose import Pose
    >>> rotations = Pose.rest().rotations.numpy()
    >>> put_hand(rotations, "left", GESTURES["fist"].values)
    >>> rotations[0, JOINTS.index("left_index1")].round(2) + 0
    array([ 0.  ,  0.  , -1.35], dtype=float32)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS

AxisAngle = tuple[float, float, float]  # axis-angle, radians

HINGED_FINGERS = ("index", "middle", "ring", "pinky")
CURL_ANGLES = (1.35, 1.75, 1.15)  # radians at each joint for curl 1; chosen: the tip is at the palm
# Share of each finger in a spread. Chosen: the middle finger hardly moves.
SPREAD_SHARES = (1.0, 0.25, -0.45, -1.0)

_STRAIGHT: tuple[AxisAngle, ...] = ((0, 0, 0), (0, 0, 0), (0, 0, 0))
_RELAXED: tuple[AxisAngle, ...] = ((0.1, 0.2, -0.1), (0, 0.1, 0), (0, 0.1, 0))
_FOLDED: tuple[AxisAngle, ...] = ((0.41, 0.27, -0.42), (0.16, 0.53, -0.10), (0.37, 1.12, -0.24))
_TO_INDEX: tuple[AxisAngle, ...] = ((0.75, 0.15, -0.30), (0, 0.25, -0.05), (0, 0.35, -0.05))
_UP: tuple[AxisAngle, ...] = ((-0.16, -0.37, 0.12), (-0.10, -0.36, 0.06), (-0.06, -0.20, 0.04))


@dataclass(frozen=True)
class Gesture:
    """A gesture of the left hand, which the right one mirrors.

    Example:
        >>> Gesture((0.5, 0.5, 0.5, 0.5), 0.0, ((0, 0, 0),) * 3).values.shape
        (14,)
    """

    curl: tuple[float, float, float, float]  # of each finger; 0 straight, 1 in the palm
    spread: float  # radians, of index and little finger from the middle finger
    thumb: tuple[AxisAngle, ...]  # of its three joints

    @property
    def values(self) -> np.ndarray:
        """The gesture as (14,) numbers that can be blended: curls, spread, thumb."""
        return np.array([*self.curl, self.spread, *np.ravel(self.thumb)])


GESTURES: Mapping[str, Gesture] = {
    "open": Gesture((0.04, 0.04, 0.04, 0.04), 0.14, _STRAIGHT),
    "rest": Gesture((0.18, 0.23, 0.27, 0.30), 0.0, _RELAXED),
    "fist": Gesture((1.0, 1.0, 1.0, 1.0), 0.0, _FOLDED),
    "point": Gesture((0.03, 1.0, 1.0, 1.0), 0.0, _FOLDED),
    "pinch": Gesture((0.52, 0.25, 0.18, 0.12), 0.05, _TO_INDEX),
    "two": Gesture((0.03, 0.03, 1.0, 1.0), 0.14, _FOLDED),
    "three": Gesture((0.03, 0.03, 0.03, 0.95), 0.14, _FOLDED),
    "four": Gesture((0.03, 0.03, 0.03, 0.03), 0.18, _FOLDED),
    "thumb": Gesture((1.0, 1.0, 1.0, 1.0), 0.0, _UP),
}


def put_hand(rotations: np.ndarray, side: str, values: np.ndarray) -> None:
    """Write values (T, 14) or (14,) of a "left" or "right" hand into rotations (T, 55, 3).

    Example:
        Half way from an open hand to a fist.

        >>> rotations = np.zeros((1, 55, 3))
        >>> halfway = (GESTURES["open"].values + GESTURES["fist"].values) / 2
        >>> put_hand(rotations, "right", halfway)
        >>> rotations[0, JOINTS.index("right_index1"), 2].round(3)
        np.float64(0.702)
    """
    mirror = np.array([1, 1, 1] if side == "left" else [1, -1, -1])
    values = np.atleast_2d(values)
    curls, spread, thumb = values[:, :4], values[:, 4], values[:, 5:].reshape(-1, 3, 3)
    for k, finger in enumerate(HINGED_FINGERS):
        for knuckle, angle in enumerate(CURL_ANGLES, start=1):
            joint = JOINTS.index(f"{side}_{finger}{knuckle}")
            rotations[:, joint, 2] = -mirror[2] * angle * curls[:, k]
        first = JOINTS.index(f"{side}_{finger}1")
        rotations[:, first, 1] = -mirror[1] * SPREAD_SHARES[k] * spread
    for k in range(3):
        rotations[:, JOINTS.index(f"{side}_thumb{k + 1}")] = mirror * thumb[:, k]
