"""Poses of many frames, moved together downhill until they agree with what the frames show.

Unknown are the corrections of the poses, turns ``δ`` and shifts ``τ`` of every frame
(:mod:`gva_mi.pose.corrections`), and ``s``, whatever else the evidence leaves open and all frames
share. A step takes a batch of frames ``k``, chosen at random so that a pass visits every frame
once, and follows the gradient of

1. ``L(δ, τ, s) = mean_k L_k(pose_k(δ, τ), s) + E(δ, τ) + E(s)``

with :class:`VectorAdam`, whose learning rates fall from ``r`` to ``decay · r``. After the first
``learn`` passes pictures have shown how the poses err that were given, and how the person moves,
and ``E`` becomes what that tells; then details are looked at, too. Before, ``E`` is a guess, and
counts for less: where it were believed, small motions would be taken for errors, and what pictures
corrected would tell no more than the guess. Half as many passes later it is asked once more.

In the first half of these passes, turns that are the same in all frames are held, too, where it is
not known what the person wears: the surface would adapt to them, and keep them there.

How well a frame agrees with a pose, ``L_k``, is for the evidence to say: masks and normals of the
posed body (:mod:`gva_mi.pose.sequence`), or pictures under a splatted avatar
(:mod:`gva_mi.fit.picture_evidence`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.console import Progress
from gva_mi.errors import InputError
from gva_mi.pose.anatomy import Anatomy
from gva_mi.pose.corrections import Corrections
from gva_mi.pose.ground import Soles
from gva_mi.pose.inference import Beliefs
from gva_mi.pose.priors import turn_rates
from gva_mi.pose.stage1 import Stage1
from gva_mi.pose.vector_adam import VectorAdam
from gva_mi.ranges import Metres, Seed, Turn, Within, require_ranges
from gva_mi.splat import Camera

BETAS = (0.9, 0.99)  # Adam's
GUESSED = 0.2  # weight of E before pictures have shown anything
AGAIN = 1.5  # times the passes after which it is inferred first: when it is inferred once more
HELD = 0.5  # of these passes, in which turns that are the same in all frames may be held


# Ranges of the options that all ways of fitting poses have.
Passes = Annotated[int, Within(1, 10_000)]
Learn = Annotated[int, Within(0, 10_000)]
Nat = Annotated[float, Within(0, 1e6, "low")]
Batch = Annotated[int, Within(1, 10_000)]
PartFrames = Annotated[int, Within(1, 10_000)]
Overlap = Annotated[int, Within(0, 5_000)]


class Evidence(Protocol):
    """What the frames of a clip say about their poses.

    Attributes:
        frames: numbers of the frames that say something.
        camera: of one of them; corrections are made along its axes.
        anatomy: of the person's joints.
        soles: of the person, as far as the shape is known by now; None: nothing holds the feet.
        shared: the leaves ``s``, each with its learning rate; often none.
        distance_shown: whether it tells how far away the person stands.
        surface_known: whether it is known what the person wears.
        unseen: joints that it does not show for now: their turns stay the likeliest.
    """

    frames: Sequence[int]
    camera: Camera
    anatomy: Anatomy
    soles: Soles | None
    shared: Sequence[tuple[Tensor, float]]
    distance_shown: bool
    surface_known: bool
    unseen: Sequence[int]

    def loss(self, frames: Sequence[int], pose: Pose) -> Tensor:
        """Mean of ``L_k`` over some frames in these poses; differentiable in poses and ``s``."""
        ...

    def energy(self) -> Tensor | float:
        """``E(s)``; zero where nothing is shared."""
        ...

    def come_closer(self) -> None:
        """Poses are nearly right: from now on, look at details that would mislead before."""
        ...


class Steps(Protocol):
    """How far poses move in a step."""

    step: float  # metres that a turned joint moves what turns with it, in a step at the start
    largest_turn: float  # radians in such a step; it limits joints with short lever arms
    translation_lr: float  # metres in a step at the start


@dataclass(frozen=True)
class DescentOptions:
    """How poses descend on eq. 1; each way of fitting poses has defaults of its own."""

    passes: Passes  # how often every frame is visited
    learn: Learn  # the first of them, after which it is inferred how stage 1 errs
    nat: Nat  # what a nat of E counts, in units of L_k
    batch: Batch  # frames of a step, at most
    step: Metres  # metres that a turned joint moves what turns with it, in a step at the start
    largest_turn: Turn  # radians in such a step; it limits joints with short lever arms
    translation_lr: Metres  # metres in a step at the start
    part: PartFrames  # frames fitted together; a longer video is cut into clips
    overlap: Overlap  # frames that a clip shares with the next
    seed: Seed  # of the order in which frames are visited

    command: ClassVar[str]  # whose options they are, for errors
    decay: ClassVar[float]  # what is left of the learning rates at the end

    def __post_init__(self) -> None:
        require_ranges(self.command, self)
        if not 2 * self.overlap < self.part:
            raise InputError(
                f"{self.command}: overlap must be less than half a part, "
                f"got overlap {self.overlap}, part {self.part}"
            )


@dataclass(frozen=True)
class Descent:
    """Where a descent ended, and what it took for probable."""

    pose: Pose  # of all T frames; those without evidence stay as they were
    beliefs: Beliefs


def descend(
    evidence: Evidence,
    start: Pose,
    arms: Tensor,
    options: DescentOptions,
    progress: Progress | None = None,
    following: Sequence[int] = (),
    may_be_right: bool = False,
) -> Descent:
    """Minimise eq. 1; the leaves ``evidence.shared`` are moved in place.

    Args:
        evidence: what some of the frames say.
        start: poses of all T frames, which are corrected.
        arms: (J,) lever arms of the person's joints, metres.
        options: weights, passes, learning rates and the seed.
        progress: called as ``progress(done, total, loss=...)`` after every step.
        following: frames without evidence, whose poses follow from what ``E`` says.
        may_be_right: whether ``start`` is where to begin if pictures agree better with it than with
            what is most probable of it, which takes all that is jerky for an error.
    """
    frames = sorted({*evidence.frames, *following})
    stage1 = Stage1.of(start, frames, evidence.camera)
    corrections = Corrections.likeliest(stage1, evidence.anatomy)
    if may_be_right:
        corrections = _better(evidence, frames, corrections, corrections.none_yet())
    adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
    seen = [i for i, k in enumerate(frames) if k not in set(following)]
    batches = [[seen[i] for i in batch] for batch in _batches(len(seen), options)]
    learnt = options.learn * len(batches) // options.passes
    nat, a_pass = GUESSED * options.nat, len(batches) // options.passes
    for step, batch in enumerate(batches):
        if step in (learnt, int(AGAIN * learnt)):
            if step == learnt:
                evidence.come_closer()
            corrections, nat = corrections.told_by(*corrections.found()), options.nat
            adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
        if step >= learnt and evidence.soles is not None and step % a_pass == learnt % a_pass:
            corrections.stand_on(evidence.soles)
        loss = evidence.loss([frames[i] for i in batch], corrections.pose(batch))
        loss = loss + nat * corrections.energy(evidence.distance_shown) + evidence.energy()
        if step < int(HELD * learnt) and not evidence.surface_known:
            loss = loss + options.nat * corrections.same_in_all()
        loss.backward()
        adam.step(options.decay ** (step / len(batches)))
        if progress is not None:
            progress(step + 1, len(batches), loss=float(loss.detach()))
    with torch.no_grad():
        found = corrections.pose(range(len(frames)))
    return Descent(with_frames(start, frames, found), corrections.beliefs)


@torch.no_grad()
def _better(evidence: Evidence, frames: list[int], *starts: Corrections) -> Corrections:
    """Of several corrections those that the frames with evidence agree with best."""
    seen = [i for i, k in enumerate(frames) if k in set(evidence.frames)]
    numbers = [frames[i] for i in seen]
    losses = [float(evidence.loss(numbers, corrections.pose(seen))) for corrections in starts]
    return starts[losses.index(min(losses))]


def with_frames(start: Pose, frames: Sequence[int], found: Pose) -> Pose:
    """Poses of T frames, in which some frames have taken the poses that were found for them.

    Args:
        start: T frames.
        frames: numbers of n of them.
        found: the n poses.
    """
    frames = list(frames)
    taken = start.map(torch.clone)
    taken.rotations[frames], taken.transl[frames] = found.rotations, found.transl
    taken.expression[frames] = found.expression
    return taken


def worse_frames(
    frames: Iterable[int], before: Tensor, after: Tensor, digits: int = 3
) -> dict[int, str]:
    """Those frames whose loss did not stay or fall, and the sentence that says so.

    Args:
        frames: that are compared.
        before: (T,) losses at the poses a fit started from.
        after: (T,) losses at the poses it found; NaN counts as worse.
        digits: of the losses in the sentence.
    """
    return {
        k: f"its loss grew from {before[k]:.{digits}f} to {after[k]:.{digits}f}"
        for k in frames
        if not after[k] <= before[k]
    }


def optimiser(
    corrections: Corrections,
    arms: Tensor,
    options: Steps,
    unseen: Sequence[int] = (),
    shared: Sequence[tuple[Tensor, float]] = (),
) -> VectorAdam:
    """What moves corrections, and the leaves ``s``.

    Args:
        corrections: their leaves.
        arms: (J,) lever arms of the person's joints, metres.
        options: how far in a step.
        unseen: joints that stay the likeliest.
        shared: the leaves ``s``, each with its learning rate.
    """
    # The three coordinates of a turn have steps of their own, which together are as long as one.
    turns = turn_rates(arms, options.step, options.largest_turn)[..., None] / 3**0.5
    turns[list(unseen)] = 0
    leaves = [(corrections.turns, turns), (corrections.moves, options.translation_lr)]
    tensors, rates = zip(*leaves, *shared, strict=True)
    return VectorAdam(tensors, rates, BETAS)


def _batches(frames: int, options: DescentOptions) -> Iterator[list[int]]:
    """Places of the frames of every step: each pass shuffles all of them and deals them out."""
    generator = torch.Generator().manual_seed(options.seed)
    count = -(-frames // options.batch)
    for _ in range(options.passes):
        order = torch.randperm(frames, generator=generator).tolist()
        yield from (order[first::count] for first in range(count))
