"""A pose with the limbs spread, in which surfaces are wrapped around Gaussians.

At rest, thighs, calves and trouser legs are a few centimetres apart, and arms are level. What
closes holes of that width would also join the legs, and arms and trunk, by webs that hang from
both. So points are moved by linear blend skinning, and what was made of them is moved back:

    1. x = A(w) x_rest,        A(w) = Σ_j w_j T_j,   T_j: legs turn outward, arms up, by SPREAD
    2. v_rest = A(w_v)⁻¹ v,    w_v: mean weights of the points around v, by 1 / distance²

A skirt is stretched between the legs, and covers them both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from gva_mi.avatar.rig import Rig
from gva_mi.avatar.skin_weights import inverse
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS

SPREAD = 0.4  # radians
AROUND = 8  # points whose weights a vertex takes
TOUCHING = 1e-3  # metres; closer points count alike


@dataclass(frozen=True)
class SpreadLimbs:
    """Points at rest, with skinning weights, and the same points with the limbs spread."""

    points: np.ndarray  # (N, 3) metres, x of eq. 1
    weights: np.ndarray  # (N, 55) rows sum to 1
    T: np.ndarray  # (55, 4, 4) of eq. 1: from the rest pose to the one with the limbs spread

    @staticmethod
    def of(rig: Rig, points: np.ndarray, weights: np.ndarray) -> SpreadLimbs:
        """Move points (N, 3) at rest, with skinning weights (N, 55), as in eq. 1."""
        rotations = torch.zeros(1, len(JOINTS), 3, dtype=torch.float64)
        for side, angle in (("left", SPREAD), ("right", -SPREAD)):
            for limb in ("hip", "shoulder"):
                rotations[0, JOINTS.index(f"{side}_{limb}"), 2] = angle
        at_rest, here = rig.joints.double(), torch.zeros(1, 3, dtype=torch.float64)
        T = turn_joints(rotations, at_rest, rig.parents, here)[1][0].numpy()
        A = _blended(weights, T)
        moved = np.einsum("nij,nj->ni", A[:, :, :3], points) + A[:, :, 3]
        return SpreadLimbs(moved, weights, T)

    def at_rest(self, vertices: np.ndarray) -> np.ndarray:
        """Move vertices (V, 3) of a surface around the points back, as in eq. 2."""
        from scipy.spatial import cKDTree

        distance, nearest = cKDTree(self.points).query(vertices, k=AROUND, workers=-1)
        share = 1 / np.maximum(distance, TOUCHING) ** 2
        share /= share.sum(1, keepdims=True)
        A = _blended(np.einsum("vk,vkj->vj", share, self.weights[nearest]), self.T)
        return np.einsum("vij,vj->vi", inverse(A[:, :, :3]), vertices - A[:, :, 3])


def _blended(weights: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return A of eq. 1, (N, 3, 4)."""
    return np.einsum("nj,jik->nik", weights, T[:, :3])
