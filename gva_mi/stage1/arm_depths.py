"""How far arms reach toward the camera: the evidence of all frames together, not of each alone.

A bone's picture hardly tells its depth. Near the picture's plane its length hardly changes, and it
never tells the sign. So the most likely pose of a frame is often far from the mean of all poses
that the frame leaves possible. But an arm at rest in the axes of a body that turns round is seen
from all sides. With the direction ``s_t`` of a bone in the axes of the chest, whose rotation is
``R_t``, a frame says

1. ``E_t(s) = t_2((π(x + L R_t s) - π(x) - d) / σ) + t_1((gain L (R_t s)_z - m) / σ_z)``

where ``x`` is the joint at which the bone starts, ``L`` the bone's length, ``d`` its picture and
``m`` the depth that the network gives it. ``t_d``, ``gain``, ``σ_z`` and the number of frames that
count as one are those of :mod:`gva_mi.stage1.evidence`. The posterior of
:class:`DirectionModel` gives a mean and a variance of the bone's depth in every
frame. In the evidence they take the place of the network's depth.

Legs keep the network's depth: with this one, feet stood worse on rendered videos.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from gva_mi.body.pose import JOINTS
from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import FREEDOM
from gva_mi.stage1.evidence import LEAST_DEPTH, LandmarkEvidence, PosedPoints
from gva_mi.stage1.normal_equations import Stage1State

CHEST = JOINTS.index("spine3")
ARMS = (("shoulder", "elbow"), ("elbow", "wrist"))
DIRECTIONS = 1000  # N: six degrees apart
SPEEDS = (0.5, 5.0)  # v_r of rest and of motion, rad/s
LASTING = (2.0, 0.7)  # seconds that a rest lasts, and a motion


def with_arm_depths(
    evidence: LandmarkEvidence, names: Sequence[str], state: Stage1State, dt: float
) -> LandmarkEvidence:
    """Return the evidence with the arms' depths from all frames.

    Args:
        evidence: of T frames.
        names: its P landmarks.
        state: a first solution: the chest's rotations, the joints' places and the bones' lengths
            are taken from it. Its offsets are those of the P landmarks.
        dt: seconds between frames.
    """
    offsets = pad(state.offsets, (0, 0, 0, len(evidence.points.rest) - len(names)))
    posed = PosedPoints.of(evidence.points, state.rotations, state.place, state.betas, offsets)
    model = DirectionModel.of(dt)
    gain, deep = evidence.gain.clone(), evidence.deep.clone()
    precision = evidence.deep_precision.clone()
    for bone, ends in _bones(evidence, names):
        directions = torch.einsum("tij,nj->tni", posed.A[:, CHEST], model.directions)
        energy, z, beyond = _energy(evidence, bone, ends, posed, state, directions)
        p = model.posterior(energy[None])[0]
        mean = (p * z).sum(1)
        gain[bone], deep[:, bone] = 1, mean + beyond
        precision[:, bone] = 1 / (p * (z - mean[:, None]).square()).sum(1)
    return replace(evidence, gain=gain, deep=deep, deep_precision=precision)


def _bones(evidence: LandmarkEvidence, names: Sequence[str]) -> list[tuple[int, tuple[int, int]]]:
    """Return the arms' bones among those of the evidence, and the joints at their ends."""
    found, bones = [], evidence.bones.tolist()
    for side in ("left", "right"):
        for bone in ARMS:
            ends = [f"{side}_{end}" for end in bone]
            if set(ends) <= set(names):
                start, end = (JOINTS.index(name) for name in ends)
                found.append((bones.index([list(names).index(n) for n in ends]), (start, end)))
    return found


def _energy(
    evidence: LandmarkEvidence,
    bone: int,
    ends: tuple[int, int],
    posed: PosedPoints,
    state: Stage1State,
    directions: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return eq. 1 of a bone and the depth along it, (T, N), for directions (T, N, 3).

    Landmarks sit beside the joints. What they show is moved by what lies between; the last value
    (T,) is how much larger the depth between the landmarks is than that between the joints.
    """
    i, j = evidence.bones[bone].tolist()
    x, end = (posed.places[:, joint] for joint in ends)
    f = torch.stack([evidence.K[0, 0], evidence.K[1, 1]]) * state.focal.exp()
    project = lambda X: f * X[..., :2] / X[..., 2:].clamp_min(LEAST_DEPTH)
    beside = project(posed.X[:, j]) - project(posed.X[:, i]) - project(end) + project(x)
    beyond = posed.X[:, j, 2] - posed.X[:, i, 2] - end[:, 2] + x[:, 2]
    gain, L = evidence.gain[bone], (end - x).norm(dim=1)
    d = evidence.pixels[:, j] - evidence.pixels[:, i] - beside
    m = evidence.deep[:, bone] - gain * beyond

    along = L[:, None, None] * directions
    z = along[..., 2]
    aside = project(x[:, None] + along) - (project(x) + d)[:, None]
    square = aside.square().sum(2), (gain * z - m[:, None]).square()
    a, b = evidence.precision[:, [i, j]].unbind(1)
    precision = a * b / (a + b), evidence.deep_precision[:, bone]
    energy = _t(square[0], precision[0], 2) + _t(square[1], precision[1], 1)
    return energy / evidence.correlated[:, None], z, beyond


def _t(square: Tensor, precision: Tensor, d: int) -> Tensor:
    """Return ``t_d`` of squared errors (T, N) with precision (T,); zero in frames without any."""
    known = (precision > 0)[:, None]
    square = torch.where(known, square * precision[:, None], 0)
    return (FREEDOM + d) / 2 * torch.log1p(square / FREEDOM)


@dataclass(frozen=True)
class DirectionModel:
    """A hidden Markov model of a limb's directions over a video, summed exactly.

    A limb's direction ``s_t`` at frame ``t`` is one of ``N`` unit vectors all over the sphere, and
    the limb either rests or moves. With the mode ``r``, ``dt`` seconds between frames and ``w`` the
    larger of ``v_r dt`` and the vectors' spacing,

    1. ``p(s_t | s_t-1, r) = (1 - q) [s_t = s_t-1] + q K_w(s_t, s_t-1)``,    ``q = (v_r dt / w)²``
    2. ``K_w(s, s') ∝ exp(-|s - s'|² / 2 w²)``

    so that a step has the variance ``(v_r dt)²`` along each axis, however small it is beside the
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
        """Spread directions evenly, along a spiral from pole to pole."""
        k = torch.arange(DIRECTIONS, dtype=torch.float64) + 0.5
        z, turn = 1 - 2 * k / DIRECTIONS, math.pi * (1 + 5**0.5) * k
        across = sqrt(1 - z.square())
        s = torch.stack([across * turn.cos(), across * turn.sin(), z], 1)
        spacing = math.sqrt(4 * math.pi / DIRECTIONS)
        steps = torch.stack([_steps(s, v * dt, spacing) for v in SPEEDS])
        stop, start = (1 - math.exp(-dt / lasting) for lasting in reversed(LASTING))
        modes = torch.tensor([[1 - start, start], [stop, 1 - stop]], dtype=torch.float64)
        return DirectionModel(s, steps, modes)

    def posterior(self, energy: Tensor) -> Tensor:
        """Return the probability of each direction in each frame, (B, T, N).

        Args:
            energy: (B, T, N) of B limbs, nats: minus the logarithm of what each frame alone says.
        """
        limbs, frames, count = energy.shape
        likely = torch.exp(energy.amin(2, keepdim=True) - energy)[:, :, None]
        forward, now = [], energy.new_full((limbs, 2, count), 0.5 / count)
        for t in range(frames):
            now = now * likely[:, t]
            forward.append(now / now.sum((1, 2), keepdim=True))
            moved = torch.einsum("brn,rnm->brm", forward[-1], self.steps)
            now = torch.einsum("brm,rq->bqm", moved, self.modes)
        found, after = torch.empty_like(energy), energy.new_ones(limbs, 2, count)
        for t in reversed(range(frames)):
            both = (forward[t] * after).sum(1)
            found[:, t] = both / both.sum(1, keepdim=True)
            after = torch.einsum("rq,bqm->brm", self.modes, after * likely[:, t])
            after = torch.einsum("brm,rnm->brn", after, self.steps)
            after = after / after.amax((1, 2), keepdim=True)
        return found


def _steps(s: Tensor, step: float, spacing: float) -> Tensor:
    """Return eq. 1 (N, N) of a mode that moves so many radians a frame."""
    w = max(step, spacing)
    K = torch.exp((s @ s.T - 1) / w**2)  # |s - s'|² = 2 - 2 s · s'
    K = K / K.sum(1, keepdim=True)
    q = (step / w) ** 2
    return q * K + (1 - q) * torch.eye(len(s), dtype=s.dtype)
