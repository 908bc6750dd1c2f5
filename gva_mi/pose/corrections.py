"""What stage 1 is corrected by: turns of all joints and a shift, in every frame, slow in time.

1. ``R_k,i = R_k,i^stage1 exp(δ_k,i)``,    ``t_k = t_k^stage1 + τ_k``

An estimator's errors last for several frames, and what one frame hides, such as a leg that points
at the camera, another frame shows in which the person has turned. So an optimiser should not move
one frame at a time. It is given other coordinates ``u`` and ``v``, of which the corrections are
smooth means:

2. ``A δ = (I + λ L)⁻¹ u``,   ``A τ = (I + λ L)⁻¹ v``,   ``L = Σ_k (e_k+1 - e_k)(e_k+1 - e_k)ᵀ``

over neighbours ``k, k + 1`` that both have evidence. The gradient by ``u`` is that by ``δ``, spread
over about √λ frames to both sides: a step for one frame also moves its neighbours, and errors that
change slowly are corrected in few steps (Nicolet et al., *Large Steps in Inverse Rendering*, 2021,
who do so with neighbours on a mesh).

``A_k,i`` turns a vector to the camera's axes, by stage 1. There, each coordinate may have steps of
its own: pictures show how a limb swings across the line of sight, and how far aside a person
stands, much better than how it leans toward the camera, and how deep. Coordinates that pictures
show weakly would hardly move if they shared their steps with the others.

What is known before any picture is looked at is an energy, a mean over the frames. Turns are
counted in metres by the length ``ℓ_i`` of their joint (:func:`gva_mi.pose.priors.prior_lengths`):

3. ``prior Σ_i |ℓ_i δ_k,i|² + hold |τ_k|²``                                    Eq. 8's regulariser
4. ``smooth Σ_i ρ(ℓ_i |δ_k+1,i - δ_k,i + (1 - γ) m_k,i|)``,    ``τ`` the same way, squared

with ``m_k,i = log(R_k,iᵀ R_k+1,i)``, how far the joint turns from frame to frame according to stage
1. Stage 1 is believed where it sees a motion well above its own jitter ``n_i``; a motion within
the jitter is taken for rest:

5. ``γ = |m|⁴ / (|m|⁴ + n_i⁴)``,    ``n_i = jitter / ℓ_i``

The turn of the whole body is always believed, ``γ = 1``, since all other turns are relative to it.
An estimator also loses a hand, or a leg, from one frame to the next. Such a jump costs by its size
and not by its square, which would smear it over all frames around:

6. ``ρ(x) = 2 c² (√(1 + x²/c²) - 1)``,    close to ``x²`` for steps within ``c``
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import roma
import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS, Pose
from gva_mi.splat import Camera


@dataclass(frozen=True)
class CorrectionOptions:
    """The numbers of eq. 2-6; each way of fitting poses has defaults of its own."""

    prior: float  # eq. 3, of the turns, for one square metre
    hold: float  # eq. 3, of the shifts, for one square metre
    smooth: float  # eq. 4, of the turns, for one square metre
    smooth_move: float  # eq. 4, of the shifts, for one square metre
    jitter: float  # eq. 5, metres between frames
    jitter_move: float  # eq. 5 for the shifts, metres between frames
    outlier: float  # c of eq. 6, metres
    reach: float  # √λ of eq. 2, frames


class Corrections:
    """``δ`` and ``τ`` of the frames that have evidence.

    Attributes:
        turns: (T, J, 3, 1) ``u``, a leaf.
        moves: (T, 3, 1) ``v``, a leaf. The last axis is what :class:`VectorAdam` takes for a
            vector: each coordinate has steps of its own.
    """

    def __init__(
        self,
        stage1: Pose,
        frames: Sequence[int],
        camera: Camera,
        lengths: Tensor,
        options: CorrectionOptions,
    ) -> None:
        """Start without any correction.

        Args:
            stage1: poses of all frames.
            frames: the T frames to be corrected, ascending.
            camera: in whose axes the leaves are expressed; that of one frame, where they differ.
            lengths: (J,) ℓ of the joints, metres.
            options: the numbers of eq. 2-6.
        """
        self._stage1 = stage1[list(frames)]
        self._rotations = self._stage1.rotations
        self._R_camera_world = torch.from_numpy(camera.T_camera_world[:3, :3].copy()).float()
        self._to_local = self._joint_axes()
        self._square_length, self._options = lengths.square(), options

        first = torch.tensor([i for i in range(len(frames) - 1) if frames[i + 1] == frames[i] + 1])
        self._first = first.to(torch.int64)  # of each pair of neighbours
        n, one = len(frames), torch.eye(len(frames))
        self._difference = (one[1:] - one[:-1])[self._first]  # (pairs, n)
        L = self._difference.T @ self._difference
        self._smooth = torch.linalg.inv(torch.eye(n) + options.reach**2 * L)  # (I + λ L)⁻¹

        self.turns = torch.zeros(n, len(lengths), 3, 1).requires_grad_()  # u
        self.moves = torch.zeros(n, 3, 1).requires_grad_()  # v
        self._rest = self._motion_within_jitter()

    def pose(self, which: Sequence[int]) -> Pose:
        """Eq. 1 for some of the frames, differentiable in the leaves.

        Args:
            which: places of the frames among the T that are corrected.
        """
        which = list(which)
        turns, moves = self._at(which)
        some = self._stage1[which]
        rotations = roma.rotvec_composition([some.rotations, turns])
        return Pose(rotations, some.transl + moves, some.expression)

    def energy(self) -> Tensor:
        """Eq. 3 and 4, a mean over the frames."""
        options, n = self._options, len(self._stage1)
        turns, moves = self._at(list(range(n)))
        rest_turns, rest_moves = self._rest
        held = options.prior * self._square_metres(turns).sum()
        held = held + options.hold * moves.square().sum()
        x = torch.einsum("pk,kjc->pjc", self._difference, turns) + rest_turns
        turned = robust(self._square_metres(x), options.outlier).sum()
        moved = (self._difference @ moves + rest_moves).square().sum()
        return (held + options.smooth * turned + options.smooth_move * moved) / n

    def _joint_axes(self) -> Tensor:
        """``Aᵀ`` (T, J, 3, 3): from the camera's axes to those of the joints, by stage 1."""
        nowhere = torch.zeros(1, len(PARENTS), 3)
        turned = turn_joints(self._rotations, nowhere, PARENTS, self._stage1.transl)[1]
        return torch.einsum("kjai,ca->kjic", turned[..., :3, :3], self._R_camera_world)

    def _at(self, which: list[int]) -> tuple[Tensor, Tensor]:
        """Eq. 2 for r of the frames: ``δ`` (r, J, 3), and ``τ`` (r, 3) in the world's axes."""
        rows = self._smooth[which]
        turns = (rows @ self.turns.flatten(1)).view(len(rows), -1, 3, 1)
        moves = rows @ self.moves[..., 0]
        return (self._to_local[which] @ turns)[..., 0], moves @ self._R_camera_world

    def _square_metres(self, turns: Tensor) -> Tensor:
        """``|ℓ_i δ_i|²`` (r, J) of turns (r, J, 3)."""
        return turns.square().sum(2) * self._square_length

    def _motion_within_jitter(self) -> tuple[Tensor, Tensor]:
        """``(1 - γ) m`` of rotations (pairs, J, 3) and of places (pairs, 3), eq. 5."""
        rotations, transl = self._rotations, self._stage1.transl
        before, after = self._first, self._first + 1
        m = roma.rotvec_composition([roma.rotvec_inverse(rotations[before]), rotations[after]])
        turns = m * _doubt(self._square_metres(m), self._options.jitter)[..., None]
        turns[:, 0] = 0
        m = transl[after] - transl[before]
        return turns, m * _doubt(m.square().sum(1), self._options.jitter_move)[:, None]


def robust(square: Tensor, outlier: float) -> Tensor:
    """``ρ`` of ``x²`` (eq. 6): ``x²`` below ``outlier``, ``2 c |x|`` far beyond it."""
    c2 = outlier**2
    return 2 * c2 * ((1 + square / c2).sqrt() - 1)


def _doubt(square: Tensor, jitter: float) -> Tensor:
    """``1 - γ`` of ``|ℓ m|²`` (eq. 5)."""
    return jitter**4 / (square.square() + jitter**4)
