"""Jaw and expression of a fit, which are corrected along with the poses (:mod:`gva_mi.fit.poses`).

They are corrected as joints are, but without the camera's axes, because a face is as deep as wide;
eyes stay. Expressions move only a few pixels of a whole body, and single-frame
estimators err anew in each frame.

1. ``R_k = R_k^given exp(δ_k)``   of the jaw,   ``ψ_k = ψ_k^given + ε_k``
2. ``δ_k = δ⁰_k + Σ_l M_kl u_l``,   and ``ε`` likewise, each coefficient for itself

The energy and the coordinates ``u`` come from a process prior of the errors and of the motion: at
first from the given faces alone, later from the corrections in frames that show the face from the
front. A jaw, or a coefficient, that is zero in all frames was not estimated, and stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.so3 import compose, turns_between
from gva_mi.prior.error_model import Stage1ErrorModel, fit_slow_part, white_level
from gva_mi.prior.inference import updated_process
from gva_mi.prior.process import ProcessPrior
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.optimize import Steps

JAW = JOINTS.index("jaw")
# Priors of slow errors before pictures have shown them, in radians and in standard deviations of a
# coefficient; frames. Chosen: coefficients do much of what a jaw does, and the jaw would take up
# their errors if a turn of a few degrees were as probable.
JAW_ERRORS = Stage1ErrorModel(white=0.0, slow=0.02, memory=6.0)
EXPRESSION_ERRORS = Stage1ErrorModel(white=0.0, slow=0.25, memory=6.0)


class FaceSteps(Steps, Protocol):
    """Step sizes of poses and faces."""

    expression_lr: float  # of a coefficient in a first step, standard deviations


class Face:
    """Corrections ``δ`` and ``ε`` of a clip.

    Attributes:
        parts: the jaw and the expression, if they were estimated.
    """

    def __init__(self, stage1: Stage1Poses, parts: Sequence[FacePart]) -> None:
        self._stage1, self.parts = stage1, parts

    @staticmethod
    def map_estimate(stage1: Stage1Poses) -> Face:
        """Return the MAP estimate before any picture is seen."""
        pose = stage1.pose
        moving = pose.expression.any(0).nonzero()[:, 0]
        jaw = pose.rotations[:, JAW : JAW + 1]
        parts = []
        if bool(jaw.any()):
            steps = turns_between(jaw[:-1], jaw[1:])
            parts.append(FacePart.map_estimate("jaw", moving[:0], stage1.times, steps, JAW_ERRORS))
        if len(moving):
            steps = pose.expression[:, moving].diff(dim=0)[..., None]
            given = moving, stage1.times, steps, EXPRESSION_ERRORS
            parts.append(FacePart.map_estimate("expression", *given))
        return Face(stage1, parts)

    def zeroed(self) -> Face:
        """Return the same prior with zero corrections: faces as they were given."""
        parts = [FacePart(p.name, p.coefficients, p.prior, 0 * p.start) for p in self.parts]
        return Face(self._stage1, parts)

    def corrected(self, pose: Pose, which: Sequence[int]) -> Pose:
        """Correct the faces of r frames by their indices among the n (eq. 1); bodies may be
        corrected.
        """
        rotations, expression = pose.rotations, pose.expression
        for part in self.parts:
            found = part.at(which)
            if part.name == "jaw":
                turned = compose(rotations[:, JAW : JAW + 1], found)
                rotations = torch.cat([rotations[:, :JAW], turned, rotations[:, JAW + 1 :]], 1)
            else:
                expression = expression.index_add(1, part.coefficients, found[..., 0])
        return Pose(rotations, pose.transl, expression)

    def energy(self) -> Tensor | float:
        """Return the energy of the corrections, a mean over the frames."""
        return sum((part.energy() for part in self.parts), start=0.0)

    def leaves(self, arms: Tensor, options: FaceSteps) -> list[tuple[Tensor, float]]:
        """Return the leaves and their first steps; the jaw's follows from its lever arm."""
        turn = min(options.step / max(float(arms[JAW]), 1e-6), options.largest_turn)
        return [(p.u, turn if p.name == "jaw" else options.expression_lr) for p in self.parts]

    @torch.no_grad()
    def centre(self) -> None:
        """Remove the mean over the frames, which the avatar's face at rest can express, too."""
        for part in self.parts:
            part.start = part.start - part.all().mean(0)

    @torch.no_grad()
    def found(self) -> list[Tensor]:
        """Return the corrections of all frames, part by part, (n, C, d)."""
        return [part.all() for part in self.parts]

    def with_updated_prior(self, found: Sequence[Tensor]) -> Face:
        """Fit the prior again to corrections that :meth:`found` returned, and start from them."""
        # The camera sees the front where its axis comes out of the face.
        seen = self._stage1.R_joint_camera[:, JAW, 2, 2] < 0
        parts = [
            part.with_updated_prior(corrections, seen, steps)
            for part, corrections, steps in zip(self.parts, found, self._steps(found), strict=True)
        ]
        return Face(self._stage1, parts)

    def _steps(self, found: Sequence[Tensor]) -> list[Tensor]:
        """Return corrected changes from frame to frame, (n - 1, C, d) for each part."""
        given, steps = self._stage1.pose, []
        for part, corrections in zip(self.parts, found, strict=True):
            if part.name == "jaw":
                R = turns_between(-given.rotations[:, JAW : JAW + 1], corrections)
                steps.append(turns_between(R[:-1], R[1:]))
            else:
                psi = given.expression[:, part.coefficients, None] + corrections
                steps.append(psi.diff(dim=0))
        return steps


class FacePart:
    """Corrections of the jaw (d = 3), or of C coefficients of the expression (d = 1).

    ``coefficients`` (C,) are numbers of the expression's, none for the jaw; ``start`` is ``δ⁰`` (n,
    C, d), and ``u`` (n, C, d) a leaf.
    """

    def __init__(self, name: str, coefficients: Tensor, prior: ProcessPrior, start: Tensor) -> None:
        self.name, self.coefficients, self.prior, self.start = name, coefficients, prior, start
        self._spread, self._precision = prior.preconditioner(start), prior.precision()
        self.u = torch.zeros_like(start).requires_grad_()

    @staticmethod
    def map_estimate(
        name: str, coefficients: Tensor, times: Tensor, steps: Tensor, guess: Stage1ErrorModel
    ) -> FacePart:
        """Return the MAP estimate for values that change by ``steps`` (n - 1, C, d)."""
        noise = replace(guess, white=white_level(steps))
        start, prior = ProcessPrior.of_stage1(times, steps, [noise] * steps.shape[1]).map_estimate()
        return FacePart(name, coefficients, prior, start)

    def at(self, which: Sequence[int]) -> Tensor:
        """Return the corrections of r frames (eq. 2), (r, C, d)."""
        which = list(which)
        spread = self._spread.rows(which)
        return self.start[which] + torch.einsum("crl,lcd->rcd", spread, self.u)

    def energy(self) -> Tensor:
        """Return the energy, a mean over the frames."""
        found = self.all()
        return self.prior.energy(self._precision, found, found) / len(found)

    def all(self) -> Tensor:
        """Return the corrections of all frames, (n, C, d)."""
        return self.at(range(len(self.start)))

    def with_updated_prior(self, found: Tensor, seen: Tensor, steps: Tensor) -> FacePart:
        """Fit the prior again to corrections (n, C, d), by the frames (n,) that show the face."""
        [noise] = set(self.prior.error_models)
        if int(seen.sum()) > 1:
            errors = -found[seen].flatten(1)
            noise = fit_slow_part(errors, self.prior.times[seen], noise.white, noise)
        error_models = [noise] * found.shape[1]
        prior = updated_process(self.prior, error_models, found, steps)
        return FacePart(self.name, self.coefficients, prior, found)
