"""Inverse kinematics of a leg with two bones, in closed form.

With the hip h, the ankle a, bones of lengths l1 and l2, d = |a − h| and u = (a − h) / d,

    1. cos α = (l1² + d² − l2²) / (2 l1 d)                the angle at the hip
    2. k = h + l1 (cos α u + sin α p)                     the knee; p ⟂ u points forward
    3. R = [bone, side, bone × side]_world · [...]_restᵀ  of thigh and shin; side = p × u

Rotations relative to the parent are R_hip = R_rootᵀ R_thigh, and so on down to the toes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import to_matrices, to_rotvecs

LONGEST = 0.999  # of its length, the largest extension of a leg


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

        Args:
            hip, ankle: (T, 3) positions, metres; an ankle out of reach is approached.
            R_root, R_foot: (T, 3, 3) rotations of pelvis and foot in the world.
        """
        thigh, shin = self.knee - self.hip, self.ankle - self.knee
        l1, l2 = np.linalg.norm(thigh), np.linalg.norm(shin)
        away = ankle - hip
        d = np.linalg.norm(away, axis=1)
        u = away / d[:, None]
        d = np.clip(d, abs(l1 - l2) + 1e-3, LONGEST * (l1 + l2))
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


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return matrices (T, 3, 3) that rotate by angles (T,) about one axis."""
    return to_matrices(angle[:, None] * np.eye(3)[axis])


def _frames(bone: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Return frames (T, 3, 3): the bone (T, 3), then ``side`` (T, 3) made orthogonal to it."""
    first = _unit(bone)
    second = _unit(side - (side * first).sum(1, keepdims=True) * first)
    return np.stack([first, second, np.cross(first, second)], axis=2)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=1, keepdims=True)
