"""One minimisation of stage 1: evidence and priors of some unknowns, by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from gva_mi.pose.film.body_prior import BodyPrior, SharedPrior
from gva_mi.pose.film.film_evidence import FilmEvidence
from gva_mi.pose.film.film_state import FilmState, Free
from gva_mi.pose.film.normal_equations import CHUNK, NormalEquations
from gva_mi.pose.film.smoothness import Smoothness

ENOUGH = 1e-4  # of the energy; a smaller gain ends the steps
DAMPING, LEAST, LARGEST = 1e-3, 1e-8, 1e6
EASIER, HARDER = 0.2, 6.0  # factors on the damping after a step that succeeds, and one that fails


@dataclass(frozen=True)
class FilmProblem:
    """Terms over the same unknowns.

    Attributes:
        free: the unknowns.
        which: of the film's landmarks, those that are compared.
        evidence, prior, shared_prior, smoothness: the terms.
    """

    free: Free
    which: Sequence[int]
    evidence: FilmEvidence
    prior: BodyPrior
    shared_prior: SharedPrior
    smoothness: Smoothness

    def minimised(self, state: FilmState, steps: int) -> FilmState:
        """Take at most some steps."""
        which, offsets = list(self.which), state.offsets
        state = replace(state, offsets=offsets[which])
        damping, energy = DAMPING, float(self.energy(state))
        for _ in range(steps):
            equations, before = self.equations(state), energy
            while damping < LARGEST:
                trial = self.free.moved(state, *equations.solve(damping))
                found = float(self.energy(trial))
                if found < energy:
                    break
                damping *= HARDER
            else:
                break
            state, energy, damping = trial, found, max(damping * EASIER, LEAST)
            if before - energy < ENOUGH * abs(before):
                break
        whole = offsets.clone()
        whole[which] = state.offsets
        return replace(state, offsets=whole)

    def energy(self, state: FilmState) -> Tensor:
        """Return the sum of all terms, nats."""
        total = self.prior.energy(state) + self.smoothness.energy(state)
        total = total + self.shared_prior.energy(state)
        return total + sum(row.energy for row in self.evidence.rows(state, derive=False))

    def equations(self, state: FilmState) -> NormalEquations:
        """Return the normal equations around a state."""
        count, F = len(state.place), self.free.per_frame
        equations = NormalEquations.zero(count, F, self.free.shared)
        for start in range(0, count, CHUNK):
            some = slice(start, start + CHUNK)
            part = replace(state, rotations=state.rotations[some], place=state.place[some])
            for row in self.evidence.of(some).rows(part, derive=True):
                by_frame, by_shared = row.jacobian[..., :F], row.jacobian[..., F:]
                equations.add(some, row.residuals, row.weights, by_frame, by_shared)
        for row in self.prior.rows(state):
            shape = (count, *row.by_frame.shape), (count, *row.by_shared.shape)
            by_frame, by_shared = row.by_frame.expand(shape[0]), row.by_shared.expand(shape[1])
            equations.add(slice(None), row.residuals, row.weights, by_frame, by_shared)
        self.smoothness.add(state, equations)
        self.shared_prior.add(state, equations)
        return equations
