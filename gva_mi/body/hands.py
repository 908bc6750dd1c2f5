"""Hand poses in few numbers: the PCA that body files carry, in and out.

    1. θ = m + Σ_k c_k u_k         pose of one hand from coefficients
    2. c = argmin |θ − m − Σ_k c_k u_k|²        its inverse, exact where K is the full 45

θ (T, 45) are the 15 joints' rotations relative to the flat hand, in radians, as everywhere in this
package. u_k is row k of the file's ``hands_components``. m is the hand that all-zero coefficients
stand for: the file's mean hand, which estimators and the usual SMPL-X software mean unless told
otherwise, or the flat hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.errors import InputError


@dataclass(frozen=True)
class HandSpace:
    """The hand poses of one side that a body file spans."""

    mean: Tensor  # (45,) the mean hand relative to the flat one, axis-angle
    components: Tensor  # (K, 45) principal components, the strongest first

    def pose(self, coefficients: Tensor, *, flat_is_zero: bool = False) -> Tensor:
        """Rotations relative to the flat hand (eq. 1).

        Args:
            coefficients: (T, K), K up to the file's.
            flat_is_zero: coefficients count from the flat hand, not from the mean one.

        Returns:
            (T, 45), differentiable in the coefficients.
        """
        rows = self._first(coefficients.shape[-1])
        offset = coefficients @ rows
        return offset if flat_is_zero else offset + self.mean

    def coefficients(self, pose: Tensor, count: int, *, flat_is_zero: bool = False) -> Tensor:
        """The coefficients that come closest to a hand (eq. 2).

        Args:
            pose: (T, 45) relative to the flat hand.
            count: how many coefficients, K.
            flat_is_zero: count them from the flat hand.

        Returns:
            (T, K), differentiable in the pose.
        """
        rows = self._first(count)
        offset = pose if flat_is_zero else pose - self.mean
        # Files hold rows that are orthonormal up to their own rounding; nothing here counts on it.
        return offset @ torch.linalg.pinv(rows)

    def _first(self, count: int) -> Tensor:
        if count > len(self.components):
            raise InputError(
                f"the hands have {count} PCA coefficients, but the body file has "
                f"{len(self.components)} components ('hands_componentsl', 'hands_componentsr')"
            )
        return self.components[:count]


def with_hands(pose: Pose, left: Tensor, right: Tensor) -> Pose:
    """A pose with other hands, (T, 45) each, relative to flat."""
    return replace(pose, left_hand_pose=left, right_hand_pose=right)
