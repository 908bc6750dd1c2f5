"""SMPL and SMPL+H among SMPL-X: their joints, files and poses in the order of ``JOINTS``.

The older bodies move the same 22 joints in the same way. They differ above them:

========  ======  ==========================================================================
Format    Joints  Beyond the 22 of the body
========  ======  ==========================================================================
SMPL      24      one joint per hand, at the knuckles: the hand is a mitten
SMPL+H    52      15 joints per hand, in SMPL-X's order
SMPL-X    55      jaw, two eyes, 15 joints per hand
========  ======  ==========================================================================

A file is *lifted* to 55 joints: joints that it lacks get no skin, so that they can turn without
effect; the mitten hangs on the middle finger's first knuckle. Shape, skin, and correctives are the
file's own, and the lifted body is exactly the old one.

What a pose keeps on its way to SMPL-X, see :func:`pose_from_smpl` and :func:`pose_from_smplh`:

* the global and the 21 body rotations carry over as they are: rest poses and axes agree;
* SMPL+H's fingers carry over; SMPL's mittens do not, the hands become flat;
* there is no face: jaw, eyes and expression are zero;
* **betas do not carry over**, for the shape spaces differ: fit them anew, or start from zero;
* ``transl`` means another place, for each body turns about its own pelvis: see
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
class Format:
    """A body format, by its joints."""

    name: str
    joints: tuple[int, ...]  # where each of its joints stands among SMPL-X's 55

    @property
    def parents(self) -> tuple[int, ...]:
        """The tree of its joints, -1 for the root."""
        among_55 = [PARENTS[j] for j in self.joints]
        return tuple(self.joints.index(p) if p >= 0 else -1 for p in among_55)


_SHARED = range(BODY.stop)  # root and body, in the same order in all three
SMPL = Format("SMPL", (*_SHARED, *_MITTENS))
SMPLH = Format("SMPL+H", (*_SHARED, *range(LEFT_HAND.start, RIGHT_HAND.stop)))
SMPLX = Format("SMPL-X", tuple(range(len(JOINTS))))
FORMATS = {len(f.joints): f for f in (SMPL, SMPLH, SMPLX)}


def lift(arrays: dict[str, np.ndarray], form: Format) -> dict[str, np.ndarray]:
    """The arrays of an SMPL or SMPL+H file on SMPL-X's 55 joints.

    Joints that the file lacks are regressed where their nearest relative is: jaw and eyes at the
    head, all fingers of a mitten at its knuckle.
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
    """SMPL's poses as poses for a body of 55 joints; the module says what carries over.

    Args:
        poses: (T, 72), global orientation and 23 body joints, axis-angle, radians.
        transl: (T, 3) metres.
        mittens: keep the two hand joints, for a body that was loaded from an SMPL file; on
            SMPL-X they would bend the middle fingers alone.
    """
    rotations = _rotations("pose_from_smpl", poses, transl, SMPL)
    if not mittens:
        rotations[:, list(_MITTENS)] = 0
    return Pose(rotations, transl, poses.new_zeros(len(poses), 0))


def pose_from_smplh(poses: Tensor, transl: Tensor) -> Pose:
    """SMPL+H's poses, as AMASS stores them, as poses for a body of 55 joints.

    Args:
        poses: (T, 156), global orientation, 21 body joints, left and right hand, axis-angle
            relative to the flat hand, radians.
        transl: (T, 3) metres.
    """
    rotations = _rotations("pose_from_smplh", poses, transl, SMPLH)
    return Pose(rotations, transl, poses.new_zeros(len(poses), 0))


def keep_pelvis(pose: Pose, pelvis: Tensor, new_pelvis: Tensor) -> Pose:
    """A pose for another body, translated so that the pelvis stays where it was in the world.

    A body turns about its own pelvis at rest, which lies elsewhere in each body and each shape:
    the pelvis of pose p is at ``pelvis + transl``.

    Args:
        pose: of the old body.
        pelvis: (3,) the old body's pelvis at rest, ``old.rest(shape).joints[0]``, metres.
        new_pelvis: (3,) the new body's.
    """
    return replace(pose, transl=pose.transl + pelvis - new_pelvis)


def _relative(joint: int, known: dict[int, int]) -> int:
    """The joint itself, else the mitten it belongs to, else its nearest ancestor that is known."""
    for hand, mitten in zip((LEFT_HAND, RIGHT_HAND), _MITTENS, strict=True):
        if hand.start <= joint < hand.stop and joint not in known:
            return mitten
    while joint not in known:
        joint = PARENTS[joint]
    return joint


def _rotations(caller: str, poses: Tensor, transl: Tensor, form: Format) -> Tensor:
    """Poses (T, 3 joints) of a format as rotations (T, 55, 3), checked."""
    joints = len(form.joints)
    if poses.ndim != 2 or poses.shape[1] != 3 * joints:
        raise ValueError(f"{caller}(): poses must be (T, {3 * joints}), got {tuple(poses.shape)}")
    if tuple(transl.shape) != (len(poses), 3):
        raise ValueError(f"{caller}(): transl must be ({len(poses)}, 3), got {tuple(transl.shape)}")
    rotations = poses.new_zeros(len(poses), len(JOINTS), 3)
    columns = torch.tensor(form.joints)
    return rotations.index_copy(1, columns, poses.unflatten(1, (joints, 3)))
