"""Which way is up in a motion, and turning it so that y is."""

from __future__ import annotations

import numpy as np
import roma
import torch
from torch import Tensor

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS

UP = ("x", "-x", "y", "-y", "z", "-z")
_CLEAR = 0.7  # share of the way from feet to head that must lie along one axis
_TO_Y = {  # axis-angle in quarter turns that takes an axis to y
    "x": (0, 0, 1), "-x": (0, 0, -1), "y": (0, 0, 0), "-y": (2, 0, 0), "z": (-1, 0, 0),
    "-z": (1, 0, 0),
}  # fmt: skip


def up_axis(rotations: np.ndarray, transl: np.ndarray, joints: np.ndarray) -> str | None:
    """Along which axis the head is above the feet, in the mean of all frames.

    Args:
        rotations: (T, 55, 3).
        transl: (T, 3) metres.
        joints: (55, 3) of any body at rest, metres.

    Returns:
        One of :data:`UP`; None where no axis is clearly up, such as for one who lies down.
    """
    T_world_rest = joint_transforms(
        torch.from_numpy(rotations), torch.from_numpy(joints), PARENTS, torch.from_numpy(transl)
    ).numpy()
    places = np.einsum("tjab,jb->tja", T_world_rest[..., :3, :3], joints) + T_world_rest[..., :3, 3]
    at = lambda name: places[:, JOINTS.index(name)]
    upward = (at("head") - (at("left_ankle") + at("right_ankle")) / 2).mean(0)
    axis = int(np.abs(upward).argmax())
    if abs(upward[axis]) < _CLEAR * np.linalg.norm(upward):
        return None
    return ("-" if upward[axis] < 0 else "") + "xyz"[axis]


def upright(
    rotations: np.ndarray, transl: np.ndarray, up: str, pelvis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A motion turned with its world, W: the root R becomes W R, and t becomes W (p + t) − p.

    For the body turns about its pelvis at rest, p, and not about the origin.

    Args:
        rotations: (T, 55, 3).
        transl: (T, 3) metres.
        up: the axis that is up, one of :data:`UP`.
        pelvis: (3,) metres.

    Returns:
        Rotations and translations in a world with y up.
    """
    turn = torch.tensor(_TO_Y[up], dtype=torch.float64) * (torch.pi / 2)
    W = roma.rotvec_to_rotmat(turn)
    rotations = rotations.copy()
    rotations[:, 0] = _turned(turn, torch.from_numpy(rotations[:, 0])).numpy()
    return rotations, (pelvis + transl) @ W.numpy().T - pelvis


def _turned(turn: Tensor, rotvecs: Tensor) -> Tensor:
    """The rotation ``turn`` (3,) after each of (T, 3)."""
    return roma.rotvec_composition([turn.expand_as(rotvecs), rotvecs])
