"""Jaw and expression of some frames, corrected along with their poses.

What the expression of a frame moves, pictures of a whole body show with a few pixels, and
estimators of single frames see it anew, and differently, in each of them. So it is corrected as
joints are (:mod:`gva_mi.pose.corrections`), without the camera's axes: a face is not deeper than it
is wide.

1. ``R_k = R_k^given exp(δ_k)``   of the jaw,   ``ψ_k = ψ_k^given + ε_k``
2. ``δ_k = δ⁰_k + Σ_l M_kl u_l``,   ``ε`` the same way, each coefficient for itself

with an energy and coordinates ``u`` that come from what is believed of the errors and of the motion
(:mod:`gva_mi.pose.prior.process`), at first from what was given alone, and then from the
corrections in those frames in which the face looks toward the camera. A coefficient that is zero in
all frames was not estimated, and stays; so does a jaw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import roma
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.so3 import compose
from gva_mi.pose.optimize import Steps
from gva_mi.pose.prior.error_model import Noise, fit_slow_part, white_level
from gva_mi.pose.prior.inference import updated_process
from gva_mi.pose.prior.process import ProcessPrior
from gva_mi.pose.stage1 import Stage1, turns_between

JAW = JOINTS.index("jaw")
# What is believed of errors that last before pictures have shown them. Much of what a jaw does
# coefficients do, too: it would take up their errors, if a turn of a few degrees were as probable.
TURN = Noise(white=0.0, slow=0.02, memory=6.0)  # radians
EXPRESSION = Noise(white=0.0, slow=0.25, memory=6.0)  # standard deviations of a coefficient


@dataclass(frozen=True)
class FaceSteps:
    """How faces are corrected."""

    turn: float  # of the jaw in a first step, radians
    expression: float  # of a coefficient in a first step, standard deviations
    nat: float  # what a nat of their energy counts

    @staticmethod
    def of(arms: Tensor, options: Steps, expression: float, nat: float) -> FaceSteps:
        """With jaws that turn as other joints do.

        Args:
            arms: (J,) lever arms of the person's joints, metres.
            options: how far joints turn in a step.
            expression, nat: as above.
        """
        turn = min(options.step / max(float(arms[JAW]), 1e-6), options.largest_turn)
        return FaceSteps(turn, expression, nat)


class Face:
    """``δ`` and ``ε`` of some frames.

    Attributes:
        parts: what is corrected, none of them where nothing was estimated.
    """

    def __init__(self, stage1: Stage1, parts: Sequence[Part]) -> None:
        self._stage1, self.parts = stage1, parts

    @staticmethod
    def map_estimate(stage1: Stage1) -> Face:
        """Where to start: what is most probable before any picture is looked at."""
        pose = stage1.pose
        moving = pose.expression.any(0).nonzero()[:, 0]
        jaw = pose.rotations[:, JAW : JAW + 1]
        parts = []
        if bool(jaw.any()):
            steps = turns_between(jaw[:-1], jaw[1:])
            parts.append(Part.map_estimate("jaw", moving[:0], stage1.times, steps, TURN))
        if len(moving):
            steps = pose.expression[:, moving].diff(dim=0)[..., None]
            parts.append(Part.map_estimate("expression", moving, stage1.times, steps, EXPRESSION))
        return Face(stage1, parts)

    def zeroed(self) -> Face:
        """The same beliefs, with nothing corrected: faces as they were given."""
        same = [(p.name, p.coefficients, p.belief, torch.zeros_like(p.start)) for p in self.parts]
        return Face(self._stage1, [Part(*part) for part in same])

    def corrected(self, pose: Pose, which: Sequence[int]) -> Pose:
        """Eq. 1 for poses of some of the frames, differentiable in the leaves.

        Args:
            pose: r frames, whose bodies may have been corrected.
            which: their places among the n.
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
        """What the corrections cost in nats, a mean over the frames."""
        return sum((part.energy() for part in self.parts), start=0.0)

    def leaves(self, steps: FaceSteps) -> list[tuple[Tensor, float]]:
        """What an optimiser moves, and how far in a first step."""
        return [(p.u, steps.turn if p.name == "jaw" else steps.expression) for p in self.parts]

    def centre(self) -> None:
        """Take away what is the same in all frames: the avatar's face at rest has it, too."""
        for part in self.parts:
            part.centre()

    def found(self) -> list[Tensor]:
        """The corrections of all frames, part by part, (n, C, d)."""
        return [part.found() for part in self.parts]

    def with_updated_prior(self, found: Sequence[Tensor]) -> Face:
        """Corrections that pictures have :meth:`found`, under what they tell of the video."""
        # Where the camera's axis comes out of the face, it looks at the person's front.
        seen = self._stage1.R_joint_camera[:, JAW, 2, 2] < 0
        parts = [
            part.with_updated_prior(corrections, seen, steps)
            for part, corrections, steps in zip(self.parts, found, self._steps(found), strict=True)
        ]
        return Face(self._stage1, parts)

    def _steps(self, found: Sequence[Tensor]) -> list[Tensor]:
        """From frame to frame, under corrections: (n - 1, C, d) for each part."""
        given, steps = self._stage1.pose, []
        for part, corrections in zip(self.parts, found, strict=True):
            if part.name == "jaw":
                R = roma.rotvec_composition([given.rotations[:, JAW : JAW + 1], corrections])
                steps.append(turns_between(R[:-1], R[1:]))
            else:
                psi = given.expression[:, part.coefficients, None] + corrections
                steps.append(psi.diff(dim=0))
        return steps


class Part:
    """Corrections of the jaw, a vector of three, or of coefficients, each one number.

    Attributes:
        name: "jaw" or "expression".
        coefficients: (C,) which of the expression's; none for the jaw.
        start: ``δ⁰`` (n, C, d).
        belief: what their energy is made of.
        u: (n, C, d), a leaf.
    """

    def __init__(
        self, name: str, coefficients: Tensor, belief: ProcessPrior, start: Tensor
    ) -> None:
        self.name, self.coefficients, self.belief, self.start = name, coefficients, belief, start
        self._spread, self._precision = belief.spread(start), belief.precision()
        self.u = torch.zeros_like(start).requires_grad_()

    @staticmethod
    def map_estimate(
        name: str, coefficients: Tensor, times: Tensor, steps: Tensor, guess: Noise
    ) -> Part:
        """What is most probable of values that change so (n - 1, C, d) from frame to frame."""
        noise = replace(guess, white=white_level(steps))
        start, belief = ProcessPrior.of_stage1(
            times, steps, [noise] * steps.shape[1]
        ).map_estimate()
        return Part(name, coefficients, belief, start)

    def at(self, which: Sequence[int]) -> Tensor:
        """Eq. 2 for r of the frames (r, C, d)."""
        which = list(which)
        return self.start[which] + torch.einsum("crl,lcd->rcd", self._spread[:, which], self.u)

    def energy(self) -> Tensor:
        """In nats, a mean over the frames."""
        found = self.at(range(len(self.start)))
        return self.belief.energy(self._precision, found, found) / len(found)

    @torch.no_grad()
    def found(self) -> Tensor:
        """The corrections of all frames as they are by now, (n, C, d)."""
        return self.at(range(len(self.start)))

    @torch.no_grad()
    def centre(self) -> None:
        """Take away the mean over the frames."""
        self.start = self.start - self.found().mean(0)

    def with_updated_prior(self, found: Tensor, seen: Tensor, steps: Tensor) -> Part:
        """The same under what corrections (n, C, d) tell, in the frames (n,) that show them."""
        [noise] = set(self.belief.noises)
        if int(seen.sum()) > 1:
            errors = -found[seen].flatten(1)
            noise = fit_slow_part(errors, self.belief.times[seen], noise.white, noise)
        noises = [noise] * found.shape[1]
        return Part(
            self.name, self.coefficients, updated_process(self.belief, noises, found, steps), found
        )
