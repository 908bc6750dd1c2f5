"""Steps along any path: feet that do not slide in their stance, and legs that reach for them.

A path gives position and yaw of the pelvis at any time. A foot stands for the fraction ``DUTY`` of
a cycle of two steps, on the footprint that suits the path in the middle of this stance, and swings
to the next footprint in the rest. It lands on the heel and leaves from the ball, with a pitch that
grows with the length of the step; heel and ball stay in place while the foot pivots on them.

The pelvis is as high as both legs allow:

    1. y(t) = min over legs of  a_y + √((STRETCH · l)² − d²)    a ankle, d its horizontal distance
    2. smoothed over the round, below its own minimum over the same window
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import to_matrices, to_rotvecs
from gva_mi.synthetic.motion.legs import Leg, about

DUTY = 0.6  # of a cycle, stance of a foot
LIFT = 0.07  # m, lift of a swinging foot
STRIKE, LEAVE = -0.3, 0.95  # rad, pitch at landing and leaving in a step of LONG
LONG = 0.6  # m
STRETCH = 0.996  # of its length, the largest extension of a leg; keeps the knee bent
SMOOTH = 0.004  # rounds, smoothing of the height of the pelvis
DENSE = 960  # moments per round at which this height is computed
TOES_OUT = 0.12  # rad
HEEL = 0.05  # m, from the ankle back to the heel


@dataclass(frozen=True)
class Path:
    """The path of a person, as functions of moments (T,) in rounds."""

    place: Callable[[np.ndarray], np.ndarray]  # (T, 2) x and z of the pelvis, metres; periodic
    yaw: Callable[[np.ndarray], np.ndarray]  # (T,) rad; periodic up to whole turns
    low: Callable[[np.ndarray], np.ndarray]  # (T,) m, pelvis below its highest position
    lean: Callable[[np.ndarray], np.ndarray]  # (T, 2) rad, of the pelvis about x and z
    cycles: int  # of two steps per round; 0: fixed feet
    apart: float = 1.0  # distance of the feet over that of the hips


@dataclass(frozen=True)
class _Foot:
    ankle: np.ndarray  # (T, 3) metres, height 0 for a flat foot
    yaw: np.ndarray  # (T,)
    pitch: np.ndarray  # (T,) rad, positive with the heel up


def follow(path: Path, rotations: np.ndarray, t: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Write root and legs into rotations (T, 55, 3) in place, and return translations (T, 3).

    ``t`` are moments (T,) in rounds, ``joints`` (55, 3) those of the body at rest, metres.
    """
    legs = [Leg.of(joints, side) for side in ("left", "right")]
    pelvis = joints[0].astype(float)
    dense = np.arange(DENSE) / DENSE
    height = np.interp(t % 1.0, dense, _height(path, legs, pelvis, dense), period=1.0)
    R_root = _root(path, t)
    rotations[:, 0] = to_rotvecs(R_root)
    place = path.place(t)
    root = np.stack([place[:, 0], height, place[:, 1]], axis=1)
    for leg, foot in zip(legs, _feet(path, legs, t), strict=True):
        hip = root + R_root @ (leg.hip - pelvis)
        R_foot = about(1, foot.yaw) @ about(0, foot.pitch)
        for name, value in leg.reach(hip, foot.ankle, R_root, R_foot).items():
            rotations[:, JOINTS.index(name)] = value
        toes = np.zeros((len(t), 3))
        toes[:, 0] = -np.maximum(foot.pitch, 0)  # they stay on the ground while the heel rises
        rotations[:, JOINTS.index(f"{leg.side}_foot")] = toes
    return root - pelvis


def _root(path: Path, t: np.ndarray) -> np.ndarray:
    lean = path.lean(t)
    return about(1, path.yaw(t)) @ to_matrices(
        np.stack([lean[:, 0], np.zeros(len(t)), lean[:, 1]], axis=1)
    )


def _height(path: Path, legs: list[Leg], pelvis: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the height of the pelvis (T,) over a whole round (eq. 1, 2)."""
    from scipy.ndimage import gaussian_filter1d, minimum_filter1d

    R_root, place = _root(path, t), path.place(t)
    highest = np.full(len(t), np.inf)
    for leg, foot in zip(legs, _feet(path, legs, t), strict=True):
        hip = R_root @ (leg.hip - pelvis)
        aside = hip[:, [0, 2]] + place - foot.ankle[:, [0, 2]]
        square = (STRETCH * leg.length) ** 2 - (aside**2).sum(1)
        highest = np.minimum(
            highest, foot.ankle[:, 1] + np.sqrt(np.maximum(square, 0.01)) - hip[:, 1]
        )
    window = SMOOTH * len(t)
    lowest = minimum_filter1d(highest, 2 * round(2 * window) + 1, mode="wrap")
    return gaussian_filter1d(lowest, window, mode="wrap") - path.low(t)


def _feet(path: Path, legs: list[Leg], t: np.ndarray) -> list[_Foot]:
    """Return both feet at moments (T,)."""
    if path.cycles == 0:
        start = np.zeros_like(t)
        still = [_print(path, leg, start) for leg in legs]
        return [_Foot(ankle, yaw, start) for ankle, yaw in still]
    return [_stepping(path, leg, t, 0.5 * (leg.side == "right")) for leg in legs]


def _stepping(path: Path, leg: Leg, t: np.ndarray, phase: float) -> _Foot:
    """Return a foot at moments (T,) that lands at ``phase`` of every cycle."""
    cycle, u = np.divmod(t * path.cycles - phase, 1.0)
    now = (cycle + phase + DUTY / 2) / path.cycles  # the middle of this stance
    (here, yaw), (there, next_yaw) = (
        _print(path, leg, when) for when in (now, now + 1 / path.cycles)
    )
    (behind, _) = _print(path, leg, now - 1 / path.cycles)
    # Pitch at landing and leaving grows with the length of the steps before and after.
    long = lambda a, b: np.minimum(np.linalg.norm(b - a, axis=1) / (2 * LONG), 1.2)
    strike, leave = STRIKE * long(behind, here), LEAVE * long(here, there)
    stand = np.clip(u / DUTY, 0, 1)
    swing = np.clip((u - DUTY) / (1 - DUTY), 0, 1)
    smooth = swing * swing * (3 - 2 * swing)
    pitch = strike * (1 - np.clip(stand / 0.22, 0, 1)) ** 2
    pitch = pitch + leave * np.clip((stand - 0.45) / 0.55, 0, 1) ** 1.5
    pitch = np.where(u < DUTY, pitch, leave + (STRIKE * long(here, there) - leave) * smooth)
    begin = _pivoted(leg, here, yaw, np.where(u < DUTY, pitch, leave))
    end = _pivoted(leg, there, next_yaw, STRIKE * long(here, there))
    ankle = begin + smooth[:, None] * (end - begin)
    far = np.linalg.norm(there - here, axis=1) / (2 * LONG)
    ankle[:, 1] += LIFT * np.minimum(0.4 + far, 1) * np.sin(np.pi * swing) ** 2
    return _Foot(ankle, yaw + smooth * (next_yaw - yaw), pitch)


def _print(path: Path, leg: Leg, when: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the footprint of a flat foot: its ankle (T, 3) and yaw (T,)."""
    sign = 1.0 if leg.side == "left" else -1.0
    yaw, place = path.yaw(when), path.place(when)
    aside = path.apart * (leg.hip[0] + leg.ankle[0]) / 2
    ankle = np.stack([place[:, 0], np.zeros(len(when)), place[:, 1]], axis=1)
    ankle[:, 0] += aside * np.cos(yaw)
    ankle[:, 2] -= aside * np.sin(yaw)
    return ankle, yaw + sign * TOES_OUT


def _pivoted(leg: Leg, flat: np.ndarray, yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Return the ankle (T, 3) of a foot that pivots on its ball (heel up) or on its heel."""
    ball = leg.ball - leg.ankle
    heel = np.array([0.0, ball[1], -HEEL])
    pivot = np.where(pitch[:, None] > 0, ball, heel)
    turned = about(1, yaw), about(1, yaw) @ about(0, pitch)
    at, moved = ((R @ pivot[..., None])[..., 0] for R in turned)
    return flat + at - moved
