"""Directions of a limb over a film: a hidden Markov model, summed exactly.

A limb's direction ``s_t`` at frame ``t`` is one of ``N`` unit vectors all over the sphere, and the
limb either rests or moves. With the mode ``r``, ``dt`` seconds between frames and ``w`` the larger
of ``v_r dt`` and the vectors' spacing,

1. ``p(s_t | s_t-1, r) = (1 - q) [s_t = s_t-1] + q K_w(s_t, s_t-1)``,    ``q = (v_r dt / w)²``
2. ``K_w(s, s') ∝ exp(-|s - s'|² / 2 w²)``

so that a step has the variance ``(v_r dt)²`` along each axis, however small it is beside the
spacing. The forward-backward algorithm (Rabiner, *A Tutorial on Hidden Markov Models*, 1989) sums
over all sequences of directions and modes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt

DIRECTIONS = 1000  # N: six degrees apart
SPEEDS = (0.5, 5.0)  # v_r of rest and of motion, rad/s
LASTING = (2.0, 0.7)  # seconds that a rest lasts, and a motion


@dataclass(frozen=True)
class DirectionModel:
    """Eq. 1 for some time between frames.

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
