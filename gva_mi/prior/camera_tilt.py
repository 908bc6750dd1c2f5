"""Camera-locked tilt: limbs that tilt toward the camera whichever way the person faces.

The depth errors of stage 1 are often the same in every frame: legs tilt toward the camera, and
images hardly show it. Relative to the body, such a limb tilts to and fro once per turn of the
person: a motion that depends on the camera. :class:`TiltPrior` penalises it.

Let ``m_k`` be a joint's turn from its mean pose in frame ``k``, and let ``R_k`` rotate the camera's
axes to the joint's. The part of the motion that is locked to the camera is, in the camera's axes,

1. ``c = P mean_k (R_k - mean R)ᵀ m_k``,    ``P = A / |A|``,    ``A = mean_k |R_k - mean R|²``

with ``A`` of the pelvis and ``|X|² = Xᵀ X``. ``P`` removes the axis about which the person turns.
``c`` is the tilt itself if the person turns around, and zero if not; below half a turn the term is
off. Images show the coordinate ``c_z``, about the line of sight, so it tells how large ``c`` is by
chance. The two coordinates in depth cost what exceeds that chance, in nats in every frame,

2. ``E = (ν + 1) / 2m · Σ_j log(1 + max(|(c_x, c_y)| / σ_j - 1, 0)² / ν)``,
   ``σ_j² = (ρ² v_j + s²) / 2``

with ``v_j`` the mean square of joint ``j``'s motion about the line of sight, and with the variances
``ρ²`` of ``c_z / v_j^(1/2)`` and ``s²`` of ``c_z`` over the joints, by medians. The cost is
Student's ``t``, because a person may point at the camera from wherever they stand. ``m`` frames
count as one, because images err in the same way in all frames where clothes look like a tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import BODY
from gva_mi.body.so3 import compose, nearest, to_matrix, to_rotvec
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import STUDENT_DOF, median_of_square
from gva_mi.prior.stage1_poses import Stage1Poses

TILTING_JOINTS = BODY  # without the pelvis, because a tilted camera tilts the whole person
SMALLEST_TILT = np.radians(0.1)  # least σ, radians; chosen: 2 mm at a foot
# m of eq. 2. Chosen: the same as for the angles of joints and for soles.
CORRELATED_FRAMES = 6.0
SMALLEST_TURN = 0.5  # least Stage1Poses.turn_amount; chosen: nearly half a turn


@dataclass(frozen=True)
class TiltPrior:
    """Penalise the camera-locked tilt of L joints of the body (eq. 2).

    It is for an estimator whose errors are inferred. If they are known, they tell how large such a
    tilt may be (:meth:`gva_mi.refine.corrections.Corrections.constant_turn_energy`).

    Attributes:
        means: (L, 3) mean rotations, axis-angle.
        swings: (n, L, 3, 3) ``R_k - mean R``.
        across: (3, 3) ``P``.
        chance: (L,) ``σ``, radians.
        shown: whether the person turns far enough to tell a tilt from a gesture.
    """

    means: Tensor
    swings: Tensor
    across: Tensor
    chance: Tensor
    shown: bool

    @staticmethod
    @torch.no_grad()
    def of(stage1: Stage1Poses, rotations: Tensor) -> TiltPrior:
        """Estimate the chance level from a motion with rotations (n, J, 3)."""
        R = stage1.R_joint_camera[:, TILTING_JOINTS]
        mean = to_matrix(rotations[:, TILTING_JOINTS]).mean(0)
        means = to_rotvec(nearest(mean))
        none, shown = torch.ones(len(means)), stage1.turn_amount > SMALLEST_TURN
        tilt = TiltPrior(means, R - R.mean(0), _across(stage1), none, shown)
        m = tilt._turns(rotations)
        sways = (R.mT @ (m - m.mean(0))[..., None])[..., 2, 0].square().mean(0)
        square = tilt._locked(m)[:, 2].square()
        usual = lambda squares: squares.median() / median_of_square(1)
        chance = (usual(square / sways.clamp_min(SMALLEST_TILT**2)) * sways + usual(square)) / 2
        return replace(tilt, chance=sqrt(chance).clamp_min(SMALLEST_TILT))

    def energy(self, rotations: Tensor, transl: Tensor, times: Tensor) -> Tensor:
        """Return eq. 2, a mean over the frames."""
        if not self.shown:
            return rotations.new_zeros(())
        in_depth = self._locked(self._turns(rotations))[:, :2]
        # Its slope at 0 is finite, too.
        size = sqrt(in_depth.square().sum(1) + (0.01 * SMALLEST_TILT) ** 2)
        beyond = (size / self.chance - 1).clamp_min(0)
        nats = (STUDENT_DOF + 1) / (2 * CORRELATED_FRAMES)
        return nats * torch.log1p(beyond.square() / STUDENT_DOF).sum()

    def _turns(self, rotations: Tensor) -> Tensor:
        """Return ``m`` (n, L, 3), radians."""
        return compose(-self.means, rotations[:, TILTING_JOINTS])

    def _locked(self, turns: Tensor) -> Tensor:
        """Return eq. 1 (L, 3), radians."""
        return (self.swings.mT @ turns[..., None]).mean(0)[..., 0] @ self.across


def _across(stage1: Stage1Poses) -> Tensor:
    """Return ``P`` (3, 3) of eq. 1."""
    swings = stage1.R_joint_camera[:, 0]
    swings = swings - swings.mean(0)
    A = (swings.mT @ swings).mean(0)
    return A / torch.linalg.matrix_norm(A, 2).clamp_min(1e-12)
