"""Camera-locked tilt: penalise limbs that tilt toward the camera wherever the person turns.

This is for an estimator whose errors are inferred; those that are known tell how large such a tilt
may be (:meth:`gva_mi.pose.corrections.Corrections.constant_turn_energy`).

Stage 1's depth errors of a limb are often the same in every frame: legs tilt toward the camera
whichever way the person faces, and images hardly show it. Relative to the body, such a limb tilts
to and fro once per turn of the person: a motion that depends on the camera. With a joint's turn
``m_k`` from its mean pose, and ``R_k``, which rotates the camera's axes to the joint's, the part of
a motion that is locked to the camera is, in the camera's axes,

1. ``c = P mean_k (R_k - mean R)ᵀ m_k``,    ``P = A / |A|``,    ``A = mean_k |R_k - mean R|²``

with ``A`` of the pelvis and ``|X|² = Xᵀ X``: ``P`` leaves out the axis about which the person
turns. ``c`` is the tilt itself if the person turns round, and zero if not; below half a turn the
term is off. Its coordinate ``c_z``, about the line of sight, is visible in images, so it shows how
large ``c`` is by chance. In depth, what exceeds that costs, in nats in every frame,

2. ``E = (ν + 1) / 2m · Σ_j log(1 + max(|(c_x, c_y)| / σ_j - 1, 0)² / ν)``,
   ``σ_j² = (ρ² v_j + s²) / 2``

with ``v_j`` the mean square of joint ``j``'s motion about the line of sight, ``ρ²`` the usual
``c_z² / v_j``, and ``s²`` the usual ``c_z²``. It is Student's ``t``, because somebody may point at
the camera from wherever they stand. ``m`` frames count as one, because images err in the same way
in all frames where clothes look like a tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.so3 import compose, to_matrix, to_rotvec
from gva_mi.core.cpu import sqrt
from gva_mi.pose.prior.error_model import FREEDOM, median_of_square
from gva_mi.pose.stage1 import Stage1

LIMBS = slice(1, 22)  # without the pelvis: a tilted camera tilts the whole person
LEAST = np.radians(0.1)  # σ: 2 mm at a foot
MEMORY = 6.0  # m, as for joints and soles that are off for a while
ROUND = 0.5  # least turn of the person: nearly half round


@dataclass(frozen=True)
class TiltPrior:
    """The chance level of camera-locked tilt of the L joints of the body."""

    means: Tensor  # (L, 3) their mean rotations, axis-angle
    swings: Tensor  # (n, L, 3, 3) ``R_k - mean R``
    across: Tensor  # (3, 3) ``P``
    chance: Tensor  # (L,) ``σ``, radians
    shown: bool  # whether the person turns far enough to separate a tilt from a gesture

    @staticmethod
    @torch.no_grad()
    def of(stage1: Stage1, rotations: Tensor) -> TiltPrior:
        """Estimate the chance level from a motion, rotations (n, J, 3)."""
        import roma  # here, as in stage1.py

        R = stage1.R_joint_camera[:, LIMBS]
        means = to_rotvec(
            roma.special_procrustes(to_matrix(rotations[:, LIMBS]).mean(0), method="svd")
        )
        none, shown = torch.ones(len(means)), stage1.turned > ROUND
        tilt = TiltPrior(means, R - R.mean(0), _across(stage1), none, shown)
        m = tilt._turns(rotations)
        sways = (R.mT @ (m - m.mean(0))[..., None])[..., 2, 0].square().mean(0)
        square = tilt._locked(m)[:, 2].square()
        usual = lambda some: some.median() / median_of_square(1)
        chance = (usual(square / sways.clamp_min(LEAST**2)) * sways + usual(square)) / 2
        return replace(tilt, chance=sqrt(chance).clamp_min(LEAST))

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 2, a mean over the frames."""
        if not self.shown:
            return rotations.new_zeros(())
        in_depth = self._locked(self._turns(rotations))[:, :2]
        size = sqrt(in_depth.square().sum(1) + (0.01 * LEAST) ** 2)  # has a slope at 0, too
        beyond = (size / self.chance - 1).clamp_min(0)
        return (FREEDOM + 1) / (2 * MEMORY) * torch.log1p(beyond.square() / FREEDOM).sum()

    def _turns(self, rotations: Tensor) -> Tensor:
        """Return ``m`` (n, L, 3), radians."""
        return compose(-self.means, rotations[:, LIMBS])

    def _locked(self, turns: Tensor) -> Tensor:
        """Return eq. 1 (L, 3), radians."""
        return (self.swings.mT @ turns[..., None]).mean(0)[..., 0] @ self.across


def _across(stage1: Stage1) -> Tensor:
    """Return ``P`` of eq. 1."""
    swings = stage1.R_joint_camera[:, 0]
    swings = swings - swings.mean(0)
    A = (swings.mT @ swings).mean(0)
    return A / torch.linalg.matrix_norm(A, 2).clamp_min(1e-12)
