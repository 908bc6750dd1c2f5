"""Nobody leans toward a camera wherever they turn.

What stage 1 gets wrong of a limb in depth, it often gets wrong in every frame: legs lean toward the
camera, whichever way the person faces, and pictures hardly tell it. Against the body, such a limb
tilts to and fro, once for every turn of the person: a motion that knows where the camera is. With a
joint's turn ``m_k`` from its mean pose, and ``R_k``, which takes the camera's axes to the joint's,
what a motion has of the camera is, in the camera's axes,

1. ``c = P mean_k (R_k - mean R)ᵀ m_k``,    ``P = A / |A|``,    ``A = mean_k |R_k - mean R|²``

with ``A`` of the pelvis and ``|X|² = Xᵀ X``: ``P`` leaves out the axis about which the person
turns. ``c`` is the lean itself of who turns round, and nothing of who does not; who turns less than
half round is left alone. Its coordinate ``c_z``, about the line of sight, is a sway that pictures
show, and by chance: people move as they like. In depth, as much is by chance, too, and what is more
costs

2. ``E = (ν + 1) / 2m · Σ_j log(1 + max(|(c_x, c_y)| / σ_j - 1, 0)² / ν)``,
   ``σ_j² = (ρ² v_j + s²) / 2``

nats in every frame, with ``v_j`` the mean square of the sways of joint ``j`` about the line of
sight, ``ρ²`` the usual ``c_z² / v_j``, and ``s²`` the usual ``c_z²``: joints that move much lean
more, but those at rest may lean a little. It is Student's ``t``, for somebody may point at the
camera from wherever they stand, and ``m`` frames count as one: all pictures err in the same way
where clothes look like a lean, so they tell it no better than a few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import roma
import torch
from torch import Tensor

from gva_mi.pose.noise import FREEDOM, median_of_square
from gva_mi.pose.stage1 import Stage1

LIMBS = slice(1, 22)  # but not the pelvis: a camera may lean, and all of the person with it
LEAST = np.radians(0.1)  # σ: 2 mm at a foot
MEMORY = 6.0  # m, as of joints and soles that are off for a while
ROUND = 0.5  # of a person's turn, at least: nearly half round


@dataclass(frozen=True)
class CameraLean:
    """How far the L joints of the body lean by chance.

    Attributes:
        means: (L, 3, 3) their mean poses.
        swings: (n, L, 3, 3) ``R_k - mean R``.
        across: (3, 3) ``P``.
        chance: (L,) ``σ``, radians.
        shown: whether the person turns so far that a lean tells itself from a gesture.
    """

    means: Tensor
    swings: Tensor
    across: Tensor
    chance: Tensor
    shown: bool

    @staticmethod
    @torch.no_grad()
    def of(stage1: Stage1, rotations: Tensor) -> CameraLean:
        """As a motion shows it.

        Args:
            stage1: of n frames.
            rotations: (n, J, 3) the motion, as far as it is known.
        """
        R = stage1.R_joint_camera[:, LIMBS]
        means = roma.special_procrustes(roma.rotvec_to_rotmat(rotations[:, LIMBS]).mean(0))
        none, shown = torch.ones(len(means)), stage1.turned > ROUND
        lean = CameraLean(means, R - R.mean(0), _across(stage1), none, shown)
        m = lean._turns(rotations)
        sways = (R.mT @ (m - m.mean(0))[..., None])[..., 2, 0].square().mean(0)
        square = lean._of(m)[:, 2].square()
        usual = lambda some: some.median() / median_of_square(1)
        chance = (usual(square / sways.clamp_min(LEAST**2)) * sways + usual(square)) / 2
        return replace(lean, chance=chance.sqrt().clamp_min(LEAST))

    def energy(self, rotations: Tensor) -> Tensor:
        """Eq. 2 of rotations (n, J, 3); differentiable."""
        if not self.shown:
            return rotations.new_zeros(())
        in_depth = self._of(self._turns(rotations))[:, :2]
        size = (in_depth.square().sum(1) + (0.01 * LEAST) ** 2).sqrt()  # has a slope at 0, too
        beyond = (size / self.chance - 1).clamp_min(0)
        return (FREEDOM + 1) / (2 * MEMORY) * torch.log1p(beyond.square() / FREEDOM).sum()

    def _turns(self, rotations: Tensor) -> Tensor:
        """``m`` (n, L, 3), radians."""
        return roma.rotmat_to_rotvec(self.means.mT @ roma.rotvec_to_rotmat(rotations[:, LIMBS]))

    def _of(self, turns: Tensor) -> Tensor:
        """Eq. 1 (L, 3), radians."""
        return (self.swings.mT @ turns[..., None]).mean(0)[..., 0] @ self.across


def _across(stage1: Stage1) -> Tensor:
    """``P`` of eq. 1."""
    swings = stage1.R_joint_camera[:, 0]
    swings = swings - swings.mean(0)
    A = (swings.mT @ swings).mean(0)
    return A / torch.linalg.matrix_norm(A, 2).clamp_min(1e-12)
