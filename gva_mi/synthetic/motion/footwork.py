"""Steps along any path: feet that do not slide in their stance, and legs that reach for them.

A path gives position and yaw of the pelvis at any time. In a cycle of two steps, a foot stands for
the fraction ``STANCE_SHARE``, on the footprint that suits the path in the middle of this stance,
and swings to the next footprint in the rest. It lands on the heel and leaves from the ball, with a
pitch that grows with the length of the step; heel and ball stay in place while the foot pivots on
them.

The pelvis is as high as both legs allow:

    1. y(t) = min over legs of  a_y + √((e l)² − d²)     a ankle, d its horizontal distance, l the
       length of the leg, e = WALKING_EXTENSION
    2. smoothed over the round, below its own minimum over the same window

A leg of two bones reaches for its foot in closed form. With the hip h, the ankle a, bones of length
l1 and l2, d = |a − h| and u = (a − h) / d,

    3. cos α = (l1² + d² − l2²) / (2 l1 d)                the angle at the hip
    4. k = h + l1 (cos α u + sin α p)                     the knee; p ⟂ u points forward
    5. R = [bone, side, bone × side]_world · [...]_restᵀ  of thigh and shin; side = p × u

Rotations relative to the parent are R_hip = R_rootᵀ R_thigh, and so on down to the toes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.rotations import about, to_matrices, to_rotvecs

# Chosen: plausible for an adult who walks.
STANCE_SHARE = 0.6  # of a cycle in which a foot stands
SWING_HEIGHT = 0.07  # m, lift of a swinging foot
LONG_STEP = 0.6  # m
STRIKE_PITCH, LEAVE_PITCH = -0.3, 0.95  # rad, pitch at landing and leaving in a step of LONG_STEP
TOES_OUT = 0.12  # rad, yaw of a foot outwards
HEEL_LENGTH = 0.05  # m, from the ankle back to the heel
# Chosen: the knee never locks, where its angle would jump.
WALKING_EXTENSION = 0.996  # of a leg's length, the largest in eq. 1
LARGEST_EXTENSION = 0.999  # of a leg's length, where an ankle is out of reach
HEIGHT_SMOOTHING = 0.004  # rounds, smoothing of the height of the pelvis (eq. 2)
HEIGHT_MOMENTS = 960  # per round at which this height is computed: four per HEIGHT_SMOOTHING


@dataclass(frozen=True)
class Path:
    """The path of a person, as functions of moments (T,) in rounds."""

    place: Callable[[np.ndarray], np.ndarray]  # (T, 2) x and z of the pelvis, metres; periodic
    yaw: Callable[[np.ndarray], np.ndarray]  # (T,) rad; periodic up to whole turns
    low: Callable[[np.ndarray], np.ndarray]  # (T,) m, pelvis below its highest position
    lean: Callable[[np.ndarray], np.ndarray]  # (T, 2) rad, of the pelvis about x and z
    cycles: int  # of two steps per round; 0: fixed feet
    apart: float = 1.0  # distance of the feet over the hips'


@dataclass(frozen=True)
class Leg:
    """The rest positions of a leg's joints, (3,) metres."""

    side: str  # "left" or "right"
    hip: np.ndarray
    knee: np.ndarray
    ankle: np.ndarray
    ball: np.ndarray  # SMPL-X's joint "foot"

    @staticmethod
    def of(joints: np.ndarray, side: str) -> Leg:
        """Take a leg from rest joints (55, 3)."""
        names = ("hip", "knee", "ankle", "foot")
        return Leg(side, *(joints[JOINTS.index(f"{side}_{name}")].astype(float) for name in names))

    @property
    def length(self) -> float:
        """Length of thigh and shin, metres."""
        thigh, shin = self.knee - self.hip, self.ankle - self.knee
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))

    def reach(
        self, hip: np.ndarray, ankle: np.ndarray, R_root: np.ndarray, R_foot: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return rotations of hip, knee and ankle by joint name, axis-angle (T, 3).

        They lead from ``hip`` to ``ankle`` (T, 3), metres; one out of reach is approached. Pelvis
        and foot have the rotations ``R_root``, ``R_foot`` (T, 3, 3) in the world.
        """
        thigh, shin = self.knee - self.hip, self.ankle - self.knee
        l1, l2 = np.linalg.norm(thigh), np.linalg.norm(shin)
        away = ankle - hip
        d = np.linalg.norm(away, axis=1)
        u = away / d[:, None]
        d = np.clip(d, abs(l1 - l2) + 1e-3, LARGEST_EXTENSION * (l1 + l2))
        forward = R_foot[:, :, 2] * [1, 0, 1] + R_root[:, :, 2]  # the knee points between both
        p = _unit(forward - (forward * u).sum(1, keepdims=True) * u)
        cosine = np.clip((l1**2 + d**2 - l2**2) / (2 * l1 * d), -1, 1)[:, None]
        knee = l1 * (cosine * u + np.sqrt(1 - cosine**2) * p)
        side = np.cross(p, u)
        R_thigh = _frames(knee, side) @ _frames(thigh[None], np.eye(3)[:1]).mT
        R_shin = _frames(d[:, None] * u - knee, side) @ _frames(shin[None], np.eye(3)[:1]).mT
        above, world = [R_root, R_thigh, R_shin], [R_thigh, R_shin, R_foot]
        return {
            f"{self.side}_{joint}": to_rotvecs(a.mT @ b)
            for joint, a, b in zip(("hip", "knee", "ankle"), above, world, strict=True)
        }


@dataclass(frozen=True)
class _Foot:
    ankle: np.ndarray  # (T, 3) metres, height 0 for a flat foot
    yaw: np.ndarray  # (T,)
    pitch: np.ndarray  # (T,) rad, positive with the heel up


def follow(path: Path, rotations: np.ndarray, t: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Write root and legs into rotations (T, 55, 3) in place, and return translations (T, 3).

    ``t`` are moments (T,) in rounds, ``joints`` (55, 3) of the body at rest, metres.
    """
    legs = [Leg.of(joints, side) for side in SIDES]
    pelvis = joints[0].astype(float)
    dense = np.arange(HEIGHT_MOMENTS) / HEIGHT_MOMENTS
    height = np.interp(t % 1.0, dense, _height(path, legs, pelvis, dense), period=1.0)
    R_root = root_rotations(path.yaw(t), path.lean(t))
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


def root_rotations(yaw: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """Return matrices (T, 3, 3): a turn by yaw (T,) after small ones (T, 2) about x and z."""
    return about(1, yaw) @ to_matrices(np.stack([lean[:, 0], 0 * yaw, lean[:, 1]], axis=1))


def _height(path: Path, legs: list[Leg], pelvis: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the height of the pelvis (T,) over a whole round (eq. 1, 2)."""
    from scipy.ndimage import gaussian_filter1d, minimum_filter1d

    R_root, place = root_rotations(path.yaw(t), path.lean(t)), path.place(t)
    highest = np.full(len(t), np.inf)
    for leg, foot in zip(legs, _feet(path, legs, t), strict=True):
        hip = R_root @ (leg.hip - pelvis)
        aside = hip[:, [0, 2]] + place - foot.ankle[:, [0, 2]]
        square = (WALKING_EXTENSION * leg.length) ** 2 - (aside**2).sum(1)
        above = np.sqrt(np.maximum(square, 0.01))
        highest = np.minimum(highest, foot.ankle[:, 1] + above - hip[:, 1])
    window = HEIGHT_SMOOTHING * len(t)
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
    now = (cycle + phase + STANCE_SHARE / 2) / path.cycles  # the middle of this stance
    prints = (_print(path, leg, now + k / path.cycles) for k in (-1, 0, 1))
    (behind, _), (here, yaw), (there, next_yaw) = prints
    # Pitch at landing and leaving grows with the length of the steps before and after.
    long = lambda a, b: np.minimum(np.linalg.norm(b - a, axis=1) / (2 * LONG_STEP), 1.2)
    strike, leave = STRIKE_PITCH * long(behind, here), LEAVE_PITCH * long(here, there)
    next_strike = STRIKE_PITCH * long(here, there)
    stand = np.clip(u / STANCE_SHARE, 0, 1)
    swing = np.clip((u - STANCE_SHARE) / (1 - STANCE_SHARE), 0, 1)
    smooth = swing * swing * (3 - 2 * swing)
    pitch = strike * (1 - np.clip(stand / 0.22, 0, 1)) ** 2
    pitch = pitch + leave * np.clip((stand - 0.45) / 0.55, 0, 1) ** 1.5
    pitch = np.where(u < STANCE_SHARE, pitch, leave + (next_strike - leave) * smooth)
    begin = _pivoted(leg, here, yaw, np.where(u < STANCE_SHARE, pitch, leave))
    end = _pivoted(leg, there, next_yaw, next_strike)
    ankle = begin + smooth[:, None] * (end - begin)
    far = np.linalg.norm(there - here, axis=1) / (2 * LONG_STEP)
    ankle[:, 1] += SWING_HEIGHT * np.minimum(0.4 + far, 1) * np.sin(np.pi * swing) ** 2
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
    heel = np.array([0.0, ball[1], -HEEL_LENGTH])
    pivot = np.where(pitch[:, None] > 0, ball, heel)
    turned = about(1, yaw), about(1, yaw) @ about(0, pitch)
    at, moved = ((R @ pivot[..., None])[..., 0] for R in turned)
    return flat + at - moved


def _frames(bone: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Return frames (T, 3, 3): the bone (T, 3), then ``side`` (T, 3) made orthogonal to it."""
    first = _unit(bone)
    second = _unit(side - (side * first).sum(1, keepdims=True) * first)
    return np.stack([first, second, np.cross(first, second)], axis=2)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=1, keepdims=True)
