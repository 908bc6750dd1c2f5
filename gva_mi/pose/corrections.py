"""What stage 1 is corrected by: turns of all joints and a shift, in every frame, slow in time.

1. ``R_k,i = R_k,i^stage1 exp(δ_k,i)``,    ``t_k = t_k^stage1 + τ_k``

An estimator's errors last for several frames, and what one frame hides, a leg that points at the
camera, another one shows in which the person has turned. So an optimiser should not move one frame
at a time. It is given other coordinates ``u`` and ``v``, of which the corrections are smooth means:

2. ``δ = (I + λ L)⁻¹ u``,    ``τ = (I + λ L)⁻¹ v``,    ``L = Σ_k (e_k+1 - e_k)(e_k+1 - e_k)ᵀ``

over neighbours ``k, k + 1`` that both have a target. The gradient by ``u`` is that by ``δ``, spread
over about √λ frames to both sides: one frame moves its neighbours, too, and long waves are
corrected in few steps (Nicolet et al., *Large Steps in Inverse Rendering*, 2021, who do so with
neighbours on a mesh).

What is known without looking is an energy, a mean over the frames:

3. ``λ2 Σ_i ω_i |δ_k,i|² + hold |τ_k|²``                                       Eq. 9's regulariser
4. ``smooth Σ_i ω_i |δ_k+1,i - δ_k,i + (1 - γ) m_k,i|²``,    the same for ``τ``

with ``m_k,i = log(R_k,iᵀ R_k+1,i)``, how far the joint turns from frame to frame according to stage
1. Stage 1 is believed where it sees a motion well above its own jitter ``n_i``; what lies within
the jitter is taken for rest:

5. ``γ = |m|² / (|m|² + n_i²)``,    ``n_i = jitter / √ω_i``

The whole body's turn is always believed, ``γ = 1``: against it all else is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import roma
import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.splat import Camera

if TYPE_CHECKING:
    from gva_mi.pose.refine import RefineOptions


class Corrections:
    """``δ`` and ``τ`` of the frames that have a target; ``turns`` and ``moves`` are the leaves.

    Shifts are held in the camera's axes, each a number of its own: pictures tell depth so much more
    weakly than the other two that it would hardly move if it shared its steps with them.
    """

    def __init__(
        self,
        stage1: Pose,
        frames: Sequence[int],
        camera: Camera,
        weights: Tensor,
        options: RefineOptions,
    ) -> None:
        """No correction yet.

        Args:
            stage1: T frames.
            frames: those to be corrected, in their order.
            camera: whose axes shifts are held in; of one frame, where they differ.
            weights: (J,) ω of the joints.
            options: λ, the weights of the energy, and the jitter.
        """
        self._stage1 = stage1[list(frames)]
        self._rotations = self._stage1.rotations
        self._R_camera_world = torch.from_numpy(camera.T_camera_world[:3, :3].copy()).float()
        self._weights, self._options = weights, options

        first = torch.tensor([i for i in range(len(frames) - 1) if frames[i + 1] == frames[i] + 1])
        self._first = first.to(torch.int64)  # of each pair of neighbours
        n, one = len(frames), torch.eye(len(frames))
        self._difference = (one[1:] - one[:-1])[self._first]  # (pairs, n)
        L = self._difference.T @ self._difference
        self._smooth = torch.linalg.inv(torch.eye(n) + options.reach**2 * L)  # (I + λ L)⁻¹

        self.turns = torch.zeros(n, len(weights), 3).requires_grad_()  # u
        self.moves = torch.zeros(n, 3, 1).requires_grad_()  # v, camera axes
        self._rest = self._motion_within_jitter()

    def pose(self, which: Sequence[int]) -> Pose:
        """Eq. 1 for some of the frames, by their place among ``frames``; differentiable."""
        turns, moves = self._at(self._smooth[list(which)])
        some = self._stage1[list(which)]
        rotations = roma.rotvec_composition([some.rotations, turns])
        return Pose.from_rotations(rotations, some.transl + moves, some.expression)

    def energy(self) -> Tensor:
        """Eq. 3 and 4, a mean over the frames."""
        turns, moves = self._at(self._smooth)
        rest_turns, rest_moves = self._rest
        options, n = self._options, len(moves)
        near = options.prior * self._sum(turns) + options.hold * moves.square().sum()
        turned = self._sum(torch.einsum("pk,kjc->pjc", self._difference, turns) + rest_turns)
        moved = (self._difference @ moves + rest_moves).square().sum()
        return (near + options.smooth * turned + options.smooth_move * moved) / n

    def _at(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Eq. 2 for rows (r, n) of the matrix: ``δ`` (r, J, 3) and ``τ`` (r, 3), world axes."""
        turns = (rows @ self.turns.flatten(1)).view(len(rows), -1, 3)
        return turns, rows @ self.moves[..., 0] @ self._R_camera_world

    def _sum(self, turns: Tensor) -> Tensor:
        """``Σ ω_i |δ_i|²`` over joints and frames."""
        return (turns.square().sum(2) @ self._weights).sum()

    def _motion_within_jitter(self) -> tuple[Tensor, Tensor]:
        """``(1 - γ) m`` of rotations (pairs, J, 3) and of places (pairs, 3), eq. 5."""
        rotations, transl = self._rotations, self._stage1.transl
        before, after = self._first, self._first + 1
        m = roma.rotvec_composition([roma.rotvec_inverse(rotations[before]), rotations[after]])
        noise = self._options.jitter**2 / self._weights[:, None]
        turns = m * noise / (m.square().sum(2, keepdim=True) + noise)
        turns[:, 0] = 0
        m = transl[after] - transl[before]
        noise = self._options.jitter_move**2
        return turns, m * noise / (m.square().sum(1, keepdim=True) + noise)
