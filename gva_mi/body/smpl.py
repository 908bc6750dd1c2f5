"""SMPL and SMPL+H: their body files on SMPL-X's 55 joints.

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

Poses of these formats are converted by :mod:`gva_mi.data.importers`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, PARENTS, RIGHT_HAND

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


def _relative(joint: int, known: dict[int, int]) -> int:
    """Return the joint if known, else its mitten, else its nearest known ancestor."""
    for hand, mitten in zip((LEFT_HAND, RIGHT_HAND), _MITTENS, strict=True):
        if hand.start <= joint < hand.stop and joint not in known:
            return mitten
    while joint not in known:
        joint = PARENTS[joint]
    return joint
