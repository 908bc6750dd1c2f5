"""All frames refined together, the clothes explained by one displacement of the surface.

The poses of all frames, the displacement ``D`` and the shape ``β``, which all frames share, go
downhill (:mod:`gva_mi.pose.descent`) on

    L = mean_k( d_k + λc Σ_parts d_k,part )    d: Eq. 8's data term (gva_mi.pose.evidence), for the
                                               body β displaced by D, posed; and once more for hands
                                               and feet, seen closer (gva_mi.pose.close_ups)
        + ν E(δ, τ)                            stage 1, motion, anatomy and the ground:
                                               gva_mi.pose.corrections
        + E(D)                                 gva_mi.pose.displacement
        + λβ |β - β^stage1|²
        + λh (h(β) - H)²                       where the height H is known: gva_mi.pose.stature
        + λs (log s)²                          with an unknown focal length: gva_mi.pose.focal

One frame cannot tell cloth from limb; many frames in which the person turns can, for the cloth goes
along with the body and the error of the pose does not. Nor does one frame tell how far a limb leans
toward the camera; the frames before and after do, in which it is seen from another side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.console import Progress
from gva_mi.pose.anatomy import Anatomy
from gva_mi.pose.clips import cut, skim
from gva_mi.pose.close_ups import CloseUps
from gva_mi.pose.descent import (
    Batch,
    DescentOptions,
    Learn,
    Nat,
    Overlap,
    PartFrames,
    Passes,
    descend,
)
from gva_mi.pose.displacement import Displacement
from gva_mi.pose.evidence import MaskAndNormals, mean_loss, seen_body
from gva_mi.pose.ground import Soles
from gva_mi.pose.job import Job, RefineOptions, Solution
from gva_mi.pose.noise import GROUPS
from gva_mi.pose.priors import lever_arms
from gva_mi.pose.stature import Stature
from gva_mi.ranges import Metres, Rate, Seed, Turn, Weight, Within

STEPS_A_PASS = 16  # at least
FINGERS = GROUPS["fingers"]
HOLD_HEIGHT = 1e3  # for one square metre between the body's height and the person's


@dataclass(frozen=True)
class SequenceOptions(DescentOptions, RefineOptions):
    """How all frames of a video are refined together."""

    # Of each hand's close-up, where the loss of the whole person counts 1.
    close_hands: Weight = 0.5
    close_feet: Weight = 0.1  # the same of a foot's: shoes are not of the body's form
    # Pixels of a hand's length in them, where the video has as many.
    hand_size: Annotated[int, Within(1, 1024)] = 44
    passes: Passes = 32  # how often every frame is visited, more often where there are very few
    batch: Batch = 4  # frames of a step, at most
    learn: Learn = 11  # the first of them, after which it is inferred how stage 1 errs
    nat: Nat = 0.015  # what a negative logarithm of a probability counts beside Eq. 8's data term
    unswap: bool = True  # legs and arms that stage 1 takes for each other are exchanged first
    cloth_smooth: Weight = 1.6e-4  # a of the displacement's energy, for one (1/m)²
    cloth_small: Weight = 10.0  # b of the displacement's energy, for one square metre
    cloth_outward: Weight = 400.0  # c of the displacement's energy, for one square metre
    betas_prior: Weight = 0.01  # λβ, for one squared standard deviation
    # Metres that a turned joint moves what hangs on it, in a step at the start.
    step: Metres = 0.012
    largest_turn: Turn = 0.03  # radians in such a step; it limits joints with short lever arms
    translation_lr: Rate = 0.006  # metres in a step at the start; depth is seen weakly
    cloth_lr: Rate = 0.003  # metres in a step at the start
    betas_lr: Rate = 0.05  # standard deviations in a step at the start
    # The focal length is an unknown, too: of somebody who stays far away it is found some per cent
    # too long, whatever the right one is.
    refine_camera: bool = False
    focal_lr: Rate = 0.003  # of its logarithm, in a step at the start
    focal_prior: Weight = 0.02  # of its logarithm's square
    part: PartFrames = 120  # frames refined together; a longer video is cut into clips
    overlap: Overlap = 16  # frames that a clip shares with the next
    # Frames of a longer video that tell what all its clips share.
    skim: Annotated[int, Within(1, 10_000)] = 96
    seed: Seed = 0  # of the order in which frames are visited

    name: ClassVar[str] = "sequence"
    command: ClassVar[str] = "refine"
    decay: ClassVar[float] = 0.03

    def __post_init__(self) -> None:
        RefineOptions.__post_init__(self)
        DescentOptions.__post_init__(self)

    @property
    def close_up_size(self) -> int:
        return self.hand_size if self.close_hands > 0 or self.close_feet > 0 else 0

    @property
    def swap_nat(self) -> float | None:
        return self.nat if self.unswap else None

    @property
    def description(self) -> str:
        return f"all frames together, seed {self.seed}"

    def clips(self, frames: int) -> list[range]:
        return cut(frames, self.part, self.overlap)

    def first_round(self, frames: int, seen: Sequence[int]) -> Sequence[int]:
        if frames <= self.part:
            return ()
        return [seen[i] for i in skim(len(seen), self.skim)]

    def steps_for(self, frames: int) -> int:
        return frames * self.passes * often(frames)

    def solve(self, job: Job, progress: Progress | None = None) -> Solution:
        return refine_sequence(job, self, progress)

    def variants(self) -> dict[str, RefineOptions]:
        return {
            "nothing inferred, no close-ups": replace(self, learn=self.passes),
            "no close-ups": replace(self, close_hands=0.0, close_feet=0.0),
            "no displacement for clothes": replace(self, cloth_lr=0.0),
            "shape of stage 1": replace(self, betas_lr=0.0),
        }


def refine_sequence(
    job: Job, options: SequenceOptions, progress: Progress | None = None
) -> Solution:
    """Refine the frames that have evidence; the others keep their pose, and affect no frame.

    Args:
        job: what is known.
        options: of the refinement.
        progress: called as ``progress(done, total, loss=...)`` after every step.
    """
    person = ClothedPerson(job, options)
    # With few frames a step takes fewer of them, and with very few they are visited more often, or
    # there would be too few steps to arrive.
    frames = len(job.evidence)
    options = replace(
        options,
        batch=max(1, min(options.batch, frames // STEPS_A_PASS)),
        passes=often(frames) * options.passes,
        learn=often(frames) * options.learn,
    )
    found = descend(person, job.pose, person.arms, options, progress, job.following)
    shape, offsets = Shape(person.shape.betas.detach()), person.offsets.detach()
    focal = float(person.focal.detach())
    ground = found.beliefs.ground
    footing = None if ground is None else ground.footing
    return Solution(found.pose, shape, offsets, found.beliefs.noise, footing, focal)


def often(frames: int) -> int:
    """How many times a pass visits each of so many frames."""
    return max(1, -(-STEPS_A_PASS // max(1, frames)))


class ClothedPerson:
    """The person of all frames, ``D`` and ``β``, compared with their masks and normals.

    This is the :class:`gva_mi.pose.descent.Evidence` of the refinement. ``D`` and ``β`` are its
    shared leaves, unless the job knows them from a first round.
    """

    distance_shown = False  # not even where the height is known: they show hair and soles, too

    def __init__(self, job: Job, options: SequenceOptions) -> None:
        rest = job.body.rest(job.shape)
        self._job, self._options, self._scene = job, options, job.scene()
        weights = {"hand": options.close_hands, "foot": options.close_feet}
        self._close_ups = CloseUps(job.fine, job.body, weights)
        self._stature = Stature.of(job.body)
        self._close = False
        self._cloth = Displacement(rest.vertices, job.body.faces, job.body.weights)
        self._betas = job.shape.betas.clone()[:, None].requires_grad_()  # (B, 1): B vectors of one
        self._log_focal = torch.zeros(1, 1, requires_grad=options.refine_camera)
        if job.known is None:
            self.shared = [(self._cloth.raw, options.cloth_lr), (self._betas, options.betas_lr)]
            if options.refine_camera:
                self.shared.append((self._log_focal, options.focal_lr))
        else:
            self._log_focal = torch.full((1, 1), job.known.focal).log()
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
    def soles(self) -> Soles:
        """The soles of this shape."""
        return Soles.of(self._job.body.rest(self.shape), self._job.body.weights)

    @property
    def surface_known(self) -> bool:
        """From a first round."""
        return self._job.known is not None

    @property
    def unseen(self) -> Sequence[int]:
        """The fingers, until they are looked at closely: before, masks' errors would bend them."""
        close = self._close and self._job.fine and self._options.close_hands > 0
        return () if close else FINGERS

    @property
    def focal(self) -> Tensor:
        """``s``, a scalar: the factor on the focal length (:mod:`gva_mi.pose.focal`)."""
        return self._log_focal.exp()[0, 0]

    @property
    def shape(self) -> Shape:
        """``β``, the shape."""
        return Shape(self._betas[:, 0])

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """The data term in these poses, a mean over their frames."""
        seen = [self._job.evidence[k] for k in frames]
        focal = self.focal.detach() if self._options.refine_camera else None
        vertices = seen_body(self._job.body, pose, self.shape, self.offsets, seen, focal)
        outlines = self._outlines(pose, seen)
        closer, o = [], self._options
        if self._close and self._job.fine:
            bodies = zip(frames, vertices.detach(), seen, strict=True)
            closer = [self._close_ups.of(*body) for body in bodies]
        return mean_loss(self._scene, vertices, seen, o.silhouette, closer, focal, outlines)

    def come_closer(self) -> None:
        """From now on, look at hands and feet by themselves: a hand must be near its picture. And
        at the lens, for which all of the person must be."""
        self._close = True

    def _outlines(self, pose: Pose, seen: Sequence[MaskAndNormals]) -> Tensor | None:
        """The person as they are by now, whose outlines tell the lens (:mod:`gva_mi.pose.focal`);
        None where it is not looked for."""
        if not (self._options.refine_camera and self._close):
            return None
        still = Pose(pose.rotations.detach(), pose.transl.detach(), pose.expression)
        person = still, Shape(self.shape.betas.detach()), self.offsets.detach()
        return seen_body(self._job.body, *person, seen, self.focal)

    def energy(self) -> Tensor:
        """``E(D) + λβ |β - β^stage1|²``."""
        o = self._options
        moved = (self.shape.betas - self._job.shape.betas).square().sum()
        cloth = self._cloth.energy(self.offsets, o.cloth_smooth, o.cloth_small, o.cloth_outward)
        energy = o.betas_prior * moved + cloth
        if o.refine_camera:
            energy = energy + o.focal_prior * self._log_focal.square().sum()
        if o.height is not None:
            energy = energy + HOLD_HEIGHT * self._stature.energy(self.shape, o.height)
        return energy
