"""Refine all frames together, with one displacement of the surface for the clothes.

The poses of all frames, and the displacement ``D`` and shape ``β`` that all frames share, are
optimised (:mod:`gva_mi.pose.optimize`) on

    L = mean_k( d_k + λc Σ_parts d_k,part )    d: Eq. 8's data term of the posed body
                                               with shape β, displaced by D; again for hands and
                                               feet (gva_mi.pose.evidence)
        + ν E(δ, τ)                            prior: stage 1, motion, anatomy, ground
                                               (gva_mi.pose.corrections)
        + λl L_landmarks                       gva_mi.pose.evidence.landmarks
        + E(D)                                 gva_mi.pose.displacement
        + λβ |β - β^stage1|²
        + λh (h(β) - H)²                       if the height H is known: gva_mi.pose.stature

One frame cannot separate cloth from limb. Many frames in which the person turns can, because the
cloth moves with the body and the pose error does not. Likewise one frame does not show how far a
limb tilts toward the camera, but its neighbours see the limb from another side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.core.console import Progress
from gva_mi.core.options import Metres, Rate, Weight, Within, options_of
from gva_mi.pose.displacement import Displacement
from gva_mi.pose.evidence.masks_normals import mean_of_losses
from gva_mi.pose.frame_losses import FrameLosses, shared_losses
from gva_mi.pose.job import RefineJob, RefineOptions, Solution
from gva_mi.pose.optimize import DescentOptions, Learn, PartFrames, Passes, PriorWeight, descend
from gva_mi.pose.optimizer import lever_arms
from gva_mi.pose.prior.anatomy import Anatomy
from gva_mi.pose.prior.error_model import GROUPS
from gva_mi.pose.prior.ground import Soles
from gva_mi.pose.stature import Stature

STEPS_A_PASS = 16  # smallest number
FINGERS = GROUPS["fingers"]
HOLD_HEIGHT = 1e3  # λh, for one square metre
HOLD_BETAS = 0.01  # λβ, for one squared standard deviation
BETAS_STEP = 0.05  # standard deviations in a first step
LANDMARK_STEP = 0.001  # metres in a first step, of the landmarks' offsets


@options_of("refine")
class SequenceOptions(DescentOptions, RefineOptions):
    """Options of the refinement of all frames together."""

    # Weight of each hand's close-up, where the loss of the whole person has weight 1.
    close_hands: Weight = 0.5
    close_feet: Weight = 0.1  # weight of each foot's close-up; shoes differ from the body
    # Pixels of a hand's length in close-ups, if the video has as many.
    hand_size: Annotated[int, Within(1, 1024)] = 44
    passes: Passes = 24  # how often every frame is visited, more often if there are very few
    learn: Learn = 8  # passes after which stage 1's error model is inferred
    prior_weight: PriorWeight = 0.015  # ν: weight of the prior beside Eq. 8's data term
    unswap: bool = True  # first fix legs and arms whose left and right stage 1 swapped
    # Metres that a joint moves the skin beyond it, in a first step.
    step: Metres = 0.012
    translation_lr: Rate = 0.006  # metres in a first step; images show depth weakly
    cloth_lr: Rate = 0.003  # metres in a first step
    landmarks: Weight = 0.015  # λl: weight of one nat of landmarks, where the video has them
    # Stage 1's error model: inferred from the video, or that of the film solver. "auto": that of
    # the film solver if it made the poses.
    errors: Literal["auto", "inferred", "film"] = "auto"
    part: PartFrames = 120  # frames refined together; a longer video is cut into clips
    # Frames of a longer video from which the unknowns that its clips share are found.
    skim: Annotated[int, Within(1, 10_000)] = 96

    name: ClassVar[str] = "sequence"
    command: ClassVar[str] = "refine"
    decay: ClassVar[float] = 0.03

    @property
    def close_up_size(self) -> int:
        """Pixels of a hand in close-ups; 0: there are none."""
        return self.hand_size if self.close_hands > 0 or self.close_feet > 0 else 0


def refine_sequence(
    job: RefineJob,
    options: SequenceOptions,
    progress: Progress | None = None,
    processes: int = 1,
) -> Solution:
    """Refine the frames that have evidence; the others keep their pose, and affect no frame.

    ``processes``, this one included, share the frames of a step; any number finds the same bits.
    """
    person = ClothedPerson(job, options)
    # With few frames a step takes fewer of them, and with very few they are visited more often:
    # otherwise there would be too few steps to converge.
    frames = len(job.evidence)
    options = replace(
        options,
        batch=max(1, min(options.batch, frames // STEPS_A_PASS)),
        passes=repeats(frames) * options.passes,
        learn=repeats(frames) * options.learn,
    )
    processes, count = min(processes, options.batch), frames * options.passes
    with shared_losses(person.frame_losses, processes, count) as person.frame_losses:
        found = descend(
            person, job.pose, person.arms, options, progress, job.following, errors=job.errors
        )
    shape, offsets = Shape(person.shape.betas.detach()), person.offsets.detach()
    ground = found.prior.ground
    contact = None if ground is None else ground.contact
    points = None if job.landmarks is None else person.landmark_offsets.detach()
    return Solution(found.pose, shape, offsets, found.prior.noise, contact, points)


def repeats(frames: int) -> int:
    """Return how many times a pass visits each of so many frames."""
    return max(1, -(-STEPS_A_PASS // max(1, frames)))


class ClothedPerson:
    """The :class:`gva_mi.pose.optimize.Evidence` of the refinement: a clothed person in all frames.

    The body with shape ``β``, displaced by ``D``, is compared with masks and normals. ``D`` and
    ``β`` are the shared leaves, unless the job knows them from a first round.
    """

    # With a known height, depth is scaled with body size and not fitted, because hair and shoes
    # bias the silhouette; without one, depth and size are ambiguous.
    distance_shown = False

    def __init__(self, job: RefineJob, options: SequenceOptions) -> None:
        rest = job.body.rest(job.shape)
        self._job, self._options = job, options
        weights = {"hand": options.close_hands, "foot": options.close_feet}
        self.frame_losses = FrameLosses(job, options.silhouette, weights)
        self._stature = Stature.of(job.body)
        self._close = False
        self._cloth = Displacement(rest.vertices, job.body.faces, job.body.weights)
        self._betas = job.shape.betas.clone()[:, None].requires_grad_()  # (B, 1): B vectors of one
        if job.known is None:
            self.shared = [(self._cloth.raw, options.cloth_lr), (self._betas, BETAS_STEP)]
            if job.landmarks is not None:
                self.landmark_offsets = torch.zeros_like(job.landmarks.rig.rest).requires_grad_()
                self.shared.append((self.landmark_offsets, LANDMARK_STEP))
        else:
            self.landmark_offsets = job.known.landmark_offsets
            self._cloth.raw, self._betas = job.known.offsets, job.known.shape.betas[:, None]
            self.shared = []
        self.anatomy = Anatomy.of(rest.joints)
        self.arms = lever_arms(rest, job.body.weights, job.body.parents)
        self.frames = sorted(job.evidence)
        self.camera = job.evidence[self.frames[0]].camera

    @property
    def offsets(self) -> Tensor:
        """``D`` (V, 3), metres."""
        return self._cloth.offsets

    @property
    def shape(self) -> Shape:
        """``β``."""
        return Shape(self._betas[:, 0])

    @property
    def soles(self) -> Soles:
        """The soles of the current shape."""
        return Soles.of(self._job.body.rest(self.shape), self._job.body.weights)

    @property
    def surface_known(self) -> bool:
        """Whether the clothes are known, from a first round."""
        return self._job.known is not None

    @property
    def unseen(self) -> Sequence[int]:
        """The fingers, until close-ups are used: before, mask errors would bend them."""
        close = self._close and self._job.fine and self._options.close_hands > 0
        return () if close else FINGERS

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """Return the data term in these poses, a mean over their frames."""
        posed = self._job.body(pose, self.shape, self.offsets)
        loss = mean_of_losses(posed.vertices, lambda x: self.frame_losses(frames, x, self._close))
        if (landmarks := self._job.landmarks) is None:
            return loss
        person = posed.T_world_rest, self.shape, self.landmark_offsets
        return loss + self._options.landmarks * landmarks.losses(frames, *person).mean()

    def enable_details(self) -> None:
        """Start to use close-ups, which need nearly right poses."""
        self._close = True

    def energy(self) -> Tensor:
        """Return the terms of clothes, shape and height."""
        o = self._options
        moved = (self.shape.betas - self._job.shape.betas).square().sum()
        energy = HOLD_BETAS * moved + self._cloth.energy(self.offsets)
        if o.height is not None:
            energy = energy + HOLD_HEIGHT * self._stature.energy(self.shape, o.height)
        if self._job.landmarks is not None:
            off = self._job.landmarks.energy(self.landmark_offsets) / len(self.frames)
            energy = energy + o.landmarks * off
        return energy
