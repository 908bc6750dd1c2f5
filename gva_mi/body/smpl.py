"""SMPL and SMPL+H: files and poses on SMPL-X's 55 joints.

All three formats share the first 22 joints:

========  ======  ==========================================================================
Format    Joints  Beyond these 22
========  ======  ==========================================================================
SMPL      24      one joint per hand, at the knuckles (a mitten)
SMPL+H    52      15 joints per hand, in SMPL-X's order
SMPL-X    55      jaw, two eyes, 15 joints per hand
========  ======  ==========================================================================

A file is *lifted* to 55 joints: missing joints get no skinning weights, and the mitten becomes the
middle finger's first knuckle. The lifted body is exactly the old one.

What a pose keeps on its way to SMPL-X (:func:`pose_from_smpl`, :func:`pose_from_smplh`):

* global and body rotations are kept, because rest poses and axes agree;
* SMPL+H's fingers are kept; SMPL's hands become flat;
* jaw, eyes and expression are zero;
* **betas are not converted**, because the shape spaces differ: fit them again, or start from zero;
* ``transl`` has another meaning, because each body rotates about its own pelvis: see
  :func:`keep_pelvis`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, PARENTS, RIGHT_HAND, Pose

_MITTENS = (JOINTS.index("left_middle1"), JOINTS.index("right_middle1"))


@dataclass(frozen=True)
class BodyFormat:
    """A body format, defined by its joints."""

    name: str
    joints: tuple[int, ...]  # their indices among SMPL-X's 55

    @property
    def parents(self) -> tuple[int, ...]:
        """Parents of its joints, -1 for the root."""
        among_55 = [PARENTS[j] for j in self.joints]
        return tuple(self.joints.index(p) if p >= 0 else -1 for p in among_55)


_SHARED = range(BODY.stop)  # root and body, in the same order in all formats
SMPL = BodyFormat("SMPL", (*_SHARED, *_MITTENS))
SMPLH = BodyFormat("SMPL+H", (*_SHARED, *range(LEFT_HAND.start, RIGHT_HAND.stop)))
SMPLX = BodyFormat("SMPL-X", tuple(range(len(JOINTS))))
FORMATS = {len(f.joints): f for f in (SMPL, SMPLH, SMPLX)}


def lift(arrays: dict[str, np.ndarray], form: BodyFormat) -> dict[str, np.ndarray]:
    """Lift the arrays of an SMPL or SMPL+H file to SMPL-X's 55 joints.

    Missing joints are regressed at their nearest relative: jaw and eyes at the head, all fingers of
    a mitten at its knuckle.
    """
    if form is SMPLX:
        return arrays
    of_file = {joint: k for k, joint in enumerate(form.joints)}
    nearest = [of_file[_relative(joint, of_file)] for joint in range(len(JOINTS))]
    vertices = len(arrays["v_template"])
    weights = np.zeros((vertices, len(JOINTS)), arrays["weights"].dtype)
    weights[:, form.joints] = arrays["weights"]
    posedirs = np.zeros((vertices, 3, len(JOINTS) - 1, 9), arrays["posedirs"].dtype)
    posedirs[:, :, np.array(form.joints[1:]) - 1] = arrays["posedirs"].reshape(vertices, 3, -1, 9)
    lifted = {
        "weights": weights,
        "posedirs": posedirs.reshape(vertices, 3, -1),
        "J_regressor": arrays["J_regressor"][nearest],
    }
    return arrays | lifted


def pose_from_smpl(poses: Tensor, transl: Tensor, *, mittens: bool = False) -> Pose:
    """Convert SMPL poses to 55 joints.

    Args:
        poses: (T, 72), global orientation and 23 body joints, axis-angle, radians.
        transl: (T, 3) metres.
        mittens: keep the two hand joints, for a body from an SMPL file; on SMPL-X they would
            bend only the middle fingers.
    """
    rotations = _rotations("pose_from_smpl", poses, transl, SMPL)
    if not mittens:
        rotations[:, list(_MITTENS)] = 0
    return Pose(rotations, transl, poses.new_zeros(len(poses), 0))


def pose_from_smplh(poses: Tensor, transl: Tensor) -> Pose:
    """Convert SMPL+H poses (T, 156), as AMASS stores them, to 55 joints.

    They are global orientation, 21 body joints, left and right hand, axis-angle relative to the
    flat hand, radians; ``transl`` (T, 3) in metres.
    """
    rotations = _rotations("pose_from_smplh", poses, transl, SMPLH)
    return Pose(rotations, transl, poses.new_zeros(len(poses), 0))


def keep_pelvis(pose: Pose, pelvis: Tensor, new_pelvis: Tensor) -> Pose:
    """Translate a pose for another body so that the pelvis stays in place in the world.

    A body rotates about its own pelvis at rest, and its posed pelvis is at ``pelvis + transl``.

    Args:
        pose: of the old body.
        pelvis: (3,) the old body's pelvis at rest, ``old.rest(shape).joints[0]``, metres.
        new_pelvis: (3,) the new body's.
    """
    return replace(pose, transl=pose.transl + pelvis - new_pelvis)


def _relative(joint: int, known: dict[int, int]) -> int:
    """Return the joint if known, else its mitten, else its nearest known ancestor."""
    for hand, mitten in zip((LEFT_HAND, RIGHT_HAND), _MITTENS, strict=True):
        if hand.start <= joint < hand.stop and joint not in known:
            return mitten
    while joint not in known:
        joint = PARENTS[joint]
    return joint


def _rotations(caller: str, poses: Tensor, transl: Tensor, form: BodyFormat) -> Tensor:
    """Check poses (T, 3 joints) of a format and convert them to rotations (T, 55, 3)."""
    joints = len(form.joints)
    if poses.ndim != 2 or poses.shape[1] != 3 * joints:
        raise ValueError(f"{caller}(): poses must be (T, {3 * joints}), got {tuple(poses.shape)}")
    if tuple(transl.shape) != (len(poses), 3):
        raise ValueError(f"{caller}(): transl must be ({len(poses)}, 3), got {tuple(transl.shape)}")
    rotations = poses.new_zeros(len(poses), len(JOINTS), 3)
    columns = torch.tensor(form.joints)
    return rotations.index_copy(1, columns, poses.unflatten(1, (joints, 3)))
