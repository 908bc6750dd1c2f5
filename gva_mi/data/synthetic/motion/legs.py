"""A leg that reaches for a point: inverse kinematics of two bones, in closed form.

With the hip h, the ankle a, bones of lengths l1 and l2, d = |a − h| and u = (a − h) / d,

    1. cos α = (l1² + d² − l2²) / (2 l1 d)                the angle at the hip
    2. k = h + l1 (cos α u + sin α p)                     the knee; p ⟂ u points forward
    3. R = [bone, side, bone × side]_world · [...]_restᵀ  of thigh and shin; side = p × u

and rotations relative to the parent are R_hip = R_rootᵀ R_thigh, and so on down to the toes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import roma
import torch

from gva_mi.body.pose import JOINTS

LONGEST = 0.999  # share of its length to which a leg is stretched at most


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
        """A leg of rest joints (55, 3)."""
        names = ("hip", "knee", "ankle", "foot")
        return Leg(side, *(joints[JOINTS.index(f"{side}_{name}")].astype(float) for name in names))

    @property
    def length(self) -> float:
        """Of thigh and shin, metres."""
        thigh, shin = self.knee - self.hip, self.ankle - self.knee
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))

    def reach(
        self, hip: np.ndarray, ankle: np.ndarray, R_root: np.ndarray, R_foot: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Rotations of hip, knee and ankle, by the joint's name, axis-angle (T, 3).

        Args:
            hip, ankle: (T, 3) where they are, metres; an ankle out of reach is not reached.
            R_root, R_foot: (T, 3, 3) how pelvis and foot are turned in the world.
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
            f"{self.side}_{joint}": to_rotvec(a.mT @ b)
            for joint, a, b in zip(("hip", "knee", "ankle"), above, world, strict=True)
        }


def to_matrix(rotvec: np.ndarray) -> np.ndarray:
    """Matrices (T, 3, 3) of axis-angles (T, 3)."""
    return roma.rotvec_to_rotmat(torch.from_numpy(rotvec)).numpy()


def to_rotvec(R: np.ndarray) -> np.ndarray:
    """Axis-angles (T, 3) of matrices (T, 3, 3)."""
    return roma.rotmat_to_rotvec(torch.from_numpy(R)).numpy()


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Matrices (T, 3, 3) that turn by angles (T,) about one of the axes."""
    return to_matrix(angle[:, None] * np.eye(3)[axis])


def _frames(bone: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Orthonormal frames (T, 3, 3) with the bone (T, 3) first, and ``side`` (T, 3) about second."""
    first = _unit(bone)
    second = _unit(side - (side * first).sum(1, keepdims=True) * first)
    return np.stack([first, second, np.cross(first, second)], axis=2)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=1, keepdims=True)
