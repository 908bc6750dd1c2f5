"""Find the up axis of a motion, and turn the motion so that y is up."""

from __future__ import annotations

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import composed, to_matrices
from gva_mi.data.joints import joint_places

UP = ("x", "-x", "y", "-y", "z", "-z")
_CLEAR = 0.7  # share of the way from feet to head that must lie along one axis
_TO_Y = {  # axis-angle in quarter turns that takes an axis to y
    "x": (0, 0, 1), "-x": (0, 0, -1), "y": (0, 0, 0), "-y": (2, 0, 0), "z": (-1, 0, 0),
    "-z": (1, 0, 0),
}  # fmt: skip


def up_axis(rotations: np.ndarray, transl: np.ndarray, joints: np.ndarray) -> str | None:
    """Return the axis of :data:`UP` along which the head is above the feet, averaged over frames.

    None if no axis is clearly up, as for a person who lies down. Arguments are those of
    :func:`joint_places`, with the joints of any body.
    """
    places = joint_places(rotations, transl, joints)
    at = lambda name: places[:, JOINTS.index(name)]
    upward = (at("head") - (at("left_ankle") + at("right_ankle")) / 2).mean(0)
    axis = int(np.abs(upward).argmax())
    if abs(upward[axis]) < _CLEAR * np.linalg.norm(upward):
        return None
    return ("-" if upward[axis] < 0 else "") + "xyz"[axis]


def upright(
    rotations: np.ndarray, transl: np.ndarray, up: str, pelvis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Turn a motion with its world, W: the root R becomes W R, and t becomes W (p + t) − p.

    A body turns about its pelvis at rest, p (3,), and not about the origin. ``up`` is one of
    :data:`UP`; afterwards y is up.
    """
    turn = np.array(_TO_Y[up], np.float64) * np.pi / 2
    rotations = rotations.copy()
    rotations[:, 0] = composed(turn, rotations[:, 0])
    return rotations, (pelvis + transl) @ to_matrices(turn).T - pelvis
