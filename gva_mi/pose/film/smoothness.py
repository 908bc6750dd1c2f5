"""Motion between frames: joints and the person accelerate little, and do not turn too fast.

Of values ``x_t`` of a joint, ``dt`` seconds apart,

1. ``E = Σ_t (ν + 3)/2 log(1 + |x_t+1 - 2 x_t + x_t-1|² / ν (a dt²)²) + |x_t+1 - x_t|² / 2 (v dt)²``

``a`` and ``v`` are standard deviations of acceleration and speed. So a film of half the frame rate
may change four times as much from step to step. For the root ``x_t+1 - x_t`` is the rotation from
one frame to the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND
from gva_mi.pose.film.film_state import FilmState, Free
from gva_mi.pose.film.normal_equations import NormalEquations
from gva_mi.pose.prior.error_model import FREEDOM
from gva_mi.pose.stage1 import turns_between

PLACE = (8.0, 1.5)  # a, v of the person: m/s², m/s
TRUNK = (8.0, 10.0)  # rad/s², rad/s: what is heavy turns evenly
LIMB = (120.0, 10.0)
FINGER = (40.0, 6.0)
_TRUNK = [
    k for k, name in enumerate(JOINTS) if name.startswith(("pelvis", "spine", "neck", "head"))
]


@dataclass(frozen=True)
class Smoothness:
    """Eq. 1 for some unknowns; ``dt`` in seconds."""

    free: Free
    dt: float

    def energy(self, state: FilmState) -> Tensor:
        """Return eq. 1, nats."""
        total = state.place.new_zeros(())
        for steps, (a, v) in self._groups(state):
            bends = steps.diff(dim=0).square().sum(-1) / (a * self.dt**2) ** 2
            total = total + (FREEDOM + 3) / 2 * torch.log1p(bends / FREEDOM).sum()
            total = total + (steps / (v * self.dt)).square().sum() / 2
        return total

    def add(self, state: FilmState, equations: NormalEquations) -> None:
        """Add eq. 1, as weighted squares, to the equations."""
        for k, (steps, (a, v)) in enumerate(self._groups(state)):
            columns = slice(3 * k, 3 * k + 3)
            equations.add_steps(steps, 1 / (v * self.dt) ** 2, columns)
            if len(steps) > 1:
                self._add_bends(steps, a, equations, columns)

    def _groups(self, state: FilmState) -> Iterator[tuple[Tensor, tuple[float, float]]]:
        """Yield the steps (T - 1, 3) of every three columns, and their a and v."""
        if self.free.travels:
            yield state.place.diff(dim=0), PLACE
        for joint in self.free.joints:
            r = state.rotations[:, joint]
            steps = r.diff(dim=0) if joint else turns_between(r[:-1], r[1:])
            if joint >= LEFT_HAND.start:
                yield steps, FINGER
            else:
                yield steps, TRUNK if joint in _TRUNK else LIMB

    def _add_bends(
        self, steps: Tensor, a: float, equations: NormalEquations, columns: slice
    ) -> None:
        bends, scale = steps.diff(dim=0), (a * self.dt**2) ** 2
        square = bends.square().sum(-1, keepdim=True) / scale
        w = (FREEDOM + 3) / (FREEDOM + square) / scale
        diagonal = equations.frames.diagonal(dim1=1, dim2=2)[:, columns]
        for start, part in ((0, 1.0), (1, -2.0), (2, 1.0)):
            some = slice(start, start + len(bends))
            diagonal[some] += part**2 * w
            equations.pull[some, columns] -= part * w * bends
        equations.next[:-2, columns] -= 2 * w
        equations.next[1:-1, columns] -= 2 * w
        equations.second[:-2, columns] += w
