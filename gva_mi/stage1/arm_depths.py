"""Infer how far arms reach toward the camera from all frames together.

A single picture hardly shows the depth of a bone. If the bone is nearly parallel to the picture's
plane, its length in the picture hardly changes with depth, and the sign is never visible. So the
most likely pose of one frame is often far from the mean of all poses that the frame leaves
possible. But an arm that rests, in the axes of a body that turns around, is seen from all sides.
With the direction ``s_t`` of a bone in the axes of the chest, whose rotation is ``R_t``, a frame
says

1. ``E_t(s) = t_2((π(x + L R_t s) - π(x) - d) / σ) + t_1((gain L (R_t s)_z - m) / σ_z)``

where ``x`` is the joint at which the bone starts, ``L`` the bone's length, ``d`` the bone in the
picture and ``m`` the depth that the network gives it. ``t_d``, ``gain``, ``σ_z`` and the number of
frames that count as one are defined in :mod:`gva_mi.stage1.evidence`. :class:`DirectionModel` gives
the posterior mean and variance of the bone's depth in every frame. In the evidence they replace the
network's depth.

Legs keep the network's depth: with inferred depths, feet stood worse on rendered videos.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.stage1.evidence import NEAREST_DEPTH, LandmarkEvidence
from gva_mi.stage1.posed_points import PosedPoints
from gva_mi.stage1.unknowns import Stage1State

CHEST = JOINTS.index("spine3")
ARMS = (("shoulder", "elbow"), ("elbow", "wrist"))
DIRECTION_COUNT = 1000  # N; chosen: six degrees apart
MODE_SPEEDS = (0.5, 5.0)  # v_r of rest and of motion, rad/s; chosen by eye
MODE_SECONDS = (2.0, 0.7)  # mean duration of a rest and of a motion; chosen by eye


def with_arm_depths(
    evidence: LandmarkEvidence, names: Sequence[str], state: Stage1State, dt: float
) -> LandmarkEvidence:
    """Replace the depths of arms in the evidence by depths inferred from all frames.

    Args:
        evidence: of T frames.
        names: its P landmarks.
        state: a first solution, which gives the chest's rotations, the joints' places and the
            bones' lengths; its offsets are of the P landmarks.
        dt: seconds between frames.
    """
    posed, model = evidence.posed(state), DirectionModel.of(dt)
    gain, depths = evidence.gain.clone(), evidence.depths.clone()
    precision = evidence.depth_precision.clone()
    for bone, ends in _bones(evidence, names):
        directions = torch.einsum("tij,nj->tni", posed.A[:, CHEST], model.directions)
        energy, z, beyond = _energy(evidence, bone, ends, posed, state, directions)
        p = model.posterior(energy[None])[0]
        mean = (p * z).sum(1)
        gain[bone], depths[:, bone] = 1, mean + beyond
        precision[:, bone] = 1 / (p * (z - mean[:, None]).square()).sum(1)
    return replace(evidence, gain=gain, depths=depths, depth_precision=precision)


def _bones(evidence: LandmarkEvidence, names: Sequence[str]) -> list[tuple[int, tuple[int, int]]]:
    """Return the index of each arm bone in the evidence, and the joints at its ends."""
    numbered, bones = [], evidence.bones.tolist()
    for side in ("left", "right"):
        for bone in ARMS:
            ends = [f"{side}_{end}" for end in bone]
            if set(ends) <= set(names):
                start, end = (JOINTS.index(name) for name in ends)
                numbered.append((bones.index([list(names).index(n) for n in ends]), (start, end)))
    return numbered


def _energy(
    evidence: LandmarkEvidence,
    bone: int,
    ends: tuple[int, int],
    posed: PosedPoints,
    state: Stage1State,
    directions: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Evaluate eq. 1 of a bone for directions (T, N, 3) in the camera's axes.

    Landmarks sit beside the joints, so what they show is corrected by the offset between them.

    Returns:
        The energy (T, N) in nats, the depth (T, N) along the bone between its joints, and the
        excess (T,) of the depth between its landmarks, metres.
    """
    i, j = evidence.bones[bone].tolist()
    x, end = (posed.places[:, joint] for joint in ends)
    f = torch.stack([evidence.K[0, 0], evidence.K[1, 1]]) * state.log_focal_scale.exp()
    project = lambda X: f * X[..., :2] / X[..., 2:].clamp_min(NEAREST_DEPTH)
    beside = project(posed.X[:, j]) - project(posed.X[:, i]) - project(end) + project(x)
    beyond = posed.X[:, j, 2] - posed.X[:, i, 2] - end[:, 2] + x[:, 2]
    gain, L = evidence.gain[bone], (end - x).norm(dim=1)
    d = evidence.pixels[:, j] - evidence.pixels[:, i] - beside
    m = evidence.depths[:, bone] - gain * beyond

    along = L[:, None, None] * directions
    z = along[..., 2]
    aside = project(x[:, None] + along) - (project(x) + d)[:, None]
    square = aside.square().sum(2), (gain * z - m[:, None]).square()
    a, b = evidence.precision[:, [i, j]].unbind(1)
    precision = a * b / (a + b), evidence.depth_precision[:, bone]
    energy = _t(square[0], precision[0], 2) + _t(square[1], precision[1], 1)
    return energy / evidence.correlated[:, None], z, beyond


def _t(square: Tensor, precision: Tensor, d: int) -> Tensor:
    """Return ``t_d`` of squared errors (T, N) with precision (T,); 0 in frames of precision 0."""
    known = (precision > 0)[:, None]
    square = torch.where(known, square * precision[:, None], 0)
    return (STUDENT_DOF + d) / 2 * torch.log1p(square / STUDENT_DOF)


@dataclass(frozen=True)
class DirectionModel:
    """A hidden Markov model of a limb's directions over a video, summed exactly.

    The direction ``s_t`` of a limb in frame ``t`` is one of ``N`` unit vectors on the sphere, and
    the limb either rests or moves. With the mode ``r``, ``dt`` seconds between frames, and ``w``
    the larger one of ``v_r dt`` and the spacing of the vectors,

    1. ``p(s_t | s_t-1, r) = (1 - q) [s_t = s_t-1] + q K_w(s_t, s_t-1)``,    ``q = (v_r dt / w)²``
    2. ``K_w(s, s') ∝ exp(-|s - s'|² / 2 w²)``

    So a step has the variance ``(v_r dt)²`` along each axis, even if that is much smaller than the
    spacing. The forward-backward algorithm (Rabiner, *A Tutorial on Hidden Markov Models*, 1989)
    sums over all sequences of directions and modes.

    Attributes:
        directions: (N, 3) unit vectors.
        steps: (2, N, N) eq. 1 of rest and of motion, from and to.
        modes: (2, 2) probabilities of a mode after a mode, from and to.
    """

    directions: Tensor
    steps: Tensor
    modes: Tensor

    @staticmethod
    def of(dt: float) -> DirectionModel:
        """Make the model, with directions spread evenly along a spiral from pole to pole."""
        k = torch.arange(DIRECTION_COUNT, dtype=torch.float64) + 0.5
        z, turn = 1 - 2 * k / DIRECTION_COUNT, math.pi * (1 + 5**0.5) * k
        across = sqrt(1 - z.square())
        s = torch.stack([across * turn.cos(), across * turn.sin(), z], 1)
        spacing = math.sqrt(4 * math.pi / DIRECTION_COUNT)
        steps = torch.stack([_steps(s, v * dt, spacing) for v in MODE_SPEEDS])
        stop, start = (1 - math.exp(-dt / seconds) for seconds in reversed(MODE_SECONDS))
        modes = torch.tensor([[1 - start, start], [stop, 1 - stop]], dtype=torch.float64)
        return DirectionModel(s, steps, modes)

    def posterior(self, energy: Tensor) -> Tensor:
        """Return the probability of each direction in each frame, (B, T, N).

        Args:
            energy: (B, T, N) of B limbs, nats: minus the log-likelihood of each frame alone.
        """
        limbs, frames, count = energy.shape
        likely = torch.exp(energy.amin(2, keepdim=True) - energy)[:, :, None]
        forward, now = [], energy.new_full((limbs, 2, count), 0.5 / count)
        for t in range(frames):
            now = now * likely[:, t]
            forward.append(now / now.sum((1, 2), keepdim=True))
            moved = torch.einsum("brn,rnm->brm", forward[-1], self.steps)
            now = torch.einsum("brm,rq->bqm", moved, self.modes)
        probabilities, after = torch.empty_like(energy), energy.new_ones(limbs, 2, count)
        for t in reversed(range(frames)):
            both = (forward[t] * after).sum(1)
            probabilities[:, t] = both / both.sum(1, keepdim=True)
            after = torch.einsum("rq,bqm->brm", self.modes, after * likely[:, t])
            after = torch.einsum("brm,rnm->brn", after, self.steps)
            after = after / after.amax((1, 2), keepdim=True)
        return probabilities


def _steps(s: Tensor, step: float, spacing: float) -> Tensor:
    """Return eq. 1 (N, N) of a mode that moves ``step`` radians a frame."""
    w = max(step, spacing)
    K = torch.exp((s @ s.T - 1) / w**2)  # |s - s'|² = 2 - 2 s · s'
    K = K / K.sum(1, keepdim=True)
    q = (step / w) ** 2
    return q * K + (1 - q) * torch.eye(len(s), dtype=s.dtype)
