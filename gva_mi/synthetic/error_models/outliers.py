"""Gross errors of poses that occur in some frames only.

* A hand is lost, and replaced by its mean pose on a straight wrist.
* Left and right leg are swapped: each has the mirrored rotations of the other.
* A frame is spoilt: the errors of all joints are several times as large.
* The whole person jumps to another place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import HANDS, JOINTS, SIDES
from gva_mi.synthetic.error_models.processes import runs

LEG = ("hip", "knee", "ankle", "foot")
LOST_FRAMES, SWAPPED_FRAMES, JUMP_FRAMES = 5.0, 4.0, 4.0  # mean length of a run
MEAN_FINGER = 0.3  # rad, curl of the fingers of the mean hand
SPOILT = 5.0  # factor on the errors in a spoilt frame
JUMP_AXES = np.array([0.6, 0.6, 1.5])  # of a jump: right, down, deep; their mean square is near 1


@dataclass(frozen=True)
class Outliers:
    """Fractions of the frames with gross errors."""

    lost: float = 0.08  # in runs: a hand
    swapped: float = 0.0  # in runs: left and right leg
    whole: float = 0.0  # single frames: all joints
    jumps: float = 0.0  # in runs: the place of the person
    jump: float = 0.08  # m, root mean square distance of a jump


def lose_hands(
    rotations: np.ndarray, outliers: Outliers, level: float, rng: np.random.Generator
) -> None:
    """Replace hands by the mean hand in some frames, in place in ``rotations`` (T, 55, 3)."""
    for side, hand in HANDS.items():
        lost = runs(rng, len(rotations), _share(level, outliers.lost), LOST_FRAMES)
        lost = min(level, 1.0) * lost[:, None, None]
        rotations[:, hand] += lost * (mean_hand(side) - rotations[:, hand])
        wrist = rotations[:, [JOINTS.index(f"{side}_wrist")]]
        rotations[:, [JOINTS.index(f"{side}_wrist")]] = (1 - lost) * wrist


def mean_hand(side: str) -> np.ndarray:
    """Return rotations (15, 3) of a relaxed hand."""
    sign = 1.0 if side == "left" else -1.0
    rotations = np.zeros((15, 3))
    rotations[:12, 2] = -sign * MEAN_FINGER  # all but the thumb
    return rotations


def swap_legs(
    rotations: np.ndarray, outliers: Outliers, level: float, rng: np.random.Generator
) -> None:
    """Swap the legs in some frames, in place in ``rotations`` (T, 55, 3)."""
    where = runs(rng, len(rotations), _share(level, outliers.swapped), SWAPPED_FRAMES)
    left, right = ([JOINTS.index(f"{side}_{name}") for name in LEG] for side in SIDES)
    mirrored = rotations[np.ix_(where, right + left)] * (1, -1, -1)  # in the plane x = 0
    rotations[np.ix_(where, left + right)] = mirrored


def spoil_frames(
    rotations: np.ndarray,
    sizes: np.ndarray,
    outliers: Outliers,
    level: float,
    rng: np.random.Generator,
) -> None:
    """Add large errors to all joints in some frames, in place in ``rotations`` (T, 55, 3).

    ``sizes`` (55, T) are the usual root mean square errors, radians.
    """
    where = rng.random(len(rotations)) < _share(level, outliers.whole)
    error = rng.normal(size=rotations.shape) / np.sqrt(3)
    rotations[where] += (level * SPOILT * sizes.T[..., None] * error)[where]


def jumps(frames: int, outliers: Outliers, level: float, rng: np.random.Generator) -> np.ndarray:
    """Draw displacements (T, 3) in camera axes, metres, constant over runs of frames."""
    away = runs(rng, frames, _share(level, outliers.jumps), JUMP_FRAMES)
    run = np.cumsum(np.diff(away, prepend=False) & away)  # its number, within a run
    where = outliers.jump * rng.normal(size=(frames + 1, 3)) * JUMP_AXES / np.sqrt(3)
    return where[run] * away[:, None]


def _share(level: float, share: float) -> float:
    return min(level * share, 0.9)
