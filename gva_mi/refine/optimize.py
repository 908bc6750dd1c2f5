"""Optimise the poses of many frames together, on evidence and prior.

Unknown are the corrections of the poses, turns ``δ`` and shifts ``τ`` of every frame
(:mod:`gva_mi.refine.corrections`), and ``s``, further unknowns of the evidence that all frames
share. A step takes a random batch of frames ``k``, so that a pass visits every frame once, and
follows the gradient of

1. ``L(δ, τ, s) = mean_k L_k(pose_k(δ, τ), s) + E(δ, τ) + E(s)``

with :class:`gva_mi.refine.vector_adam.VectorAdam`, whose learning rates fall from ``r`` to
``decay · r``.

``E(δ, τ)`` is the prior. It is first estimated from stage 1 alone, and has a low weight: otherwise
small motions would be taken for errors, and the corrections would show no more than the guess.
After ``learn`` passes the error model and the speed of the motion are inferred from the corrections
that the images made, the prior gets its full weight, and details such as hands are compared. After
half as many further passes the prior is inferred once more.

A known estimator may err more while a joint moves, by the lag of :mod:`gva_mi.prior.error_model`.
Then the MAP estimate takes a fast gesture for an error and flattens it, even if the estimator saw
it well. The images of a frame show which it is: they multiply the lag there by

2. ``w_k = exp(-(max(0, L_k(MAP) - L_k(stage 1)) / contradiction)²)``

and the MAP estimate is made again.

If the clothes are unknown, turns that are the same in all frames are penalised during the first
half of the ``learn`` passes. Otherwise the clothes' surface would adapt to these turns, and keep
them. If the estimator's errors are known, so is their mean, and the prior penalises these turns
throughout.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.core.options import Metres, PythonOnly, Seed, Turn, Within
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.error_model import Stage1ErrorModel
from gva_mi.prior.ground import Soles
from gva_mi.prior.inference import PosePrior
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.corrections import Corrections
from gva_mi.refine.vector_adam import VectorAdam, turn_rates
from gva_mi.splat import Camera

EARLY_PRIOR_WEIGHT = 0.2  # factor on the prior before it is inferred from corrections; by eye
SECOND_INFERENCE = 1.5  # the prior is inferred again after so many ``learn`` passes; by eye
# Of eq. 2, units of L_k. Chosen by the poses of four rendered videos, one of them with gestures.
CONTRADICTION = 0.6
CONSTANT_TURN_SHARE = 0.5  # of the ``learn`` passes, that penalise turns of all frames; by eye

# Types of options that several fits of poses have, with their ranges.
Passes = Annotated[int, Within(1, 10_000)]
Learn = Annotated[int, Within(0, 10_000)]
PriorWeight = Annotated[float, Within(0, 1e6, "low")]
PartFrames = Annotated[int, Within(1, 10_000)]
# Pixels of the person's longer side in the images that are compared.
PersonSize = Annotated[int, Within(1, 4096)]
Faces = Annotated[int, Within(500, 1_000_000)]  # a body with fewer triangles has no hands left


class Evidence(Protocol):
    """Comparison of a clip's poses with its frames.

    Attributes:
        frames: numbers of the frames that have evidence.
        camera: of one of them; corrections are made along its axes.
        anatomy: of the person's joints.
        soles: of the person, for the current shape; None: no ground term.
        shared: the leaves ``s``, each with its learning rate; often none.
        distance_shown: whether it shows how far away the person is.
        surface_known: whether the person's clothes are known.
        unseen: joints that it does not show yet, whose rotations stay at the MAP estimate.
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
        """Return the mean of ``L_k`` over some frames; differentiable in poses and ``s``."""
        ...

    def energy(self) -> Tensor | float:
        """Return ``E(s)``; zero if nothing is shared."""
        ...

    def enable_details(self) -> None:
        """Start to compare details that would mislead while poses are far off."""
        ...


class Steps(Protocol):
    """Step sizes of poses; fields as in :class:`DescentOptions`."""

    step: float
    largest_turn: float
    translation_lr: float


@dataclass(frozen=True)
class DescentOptions:
    """Options of the optimisation; each method has its own defaults."""

    passes: Passes  # how often every frame is visited
    learn: Learn  # passes after which the prior is inferred from corrections
    prior_weight: PriorWeight  # weight of the prior, units of L_k per nat
    step: Metres  # metres that a joint moves the skin beyond it, in a first step
    translation_lr: Metres  # metres in a first step
    part: PartFrames  # frames fitted together; a longer video is cut into clips
    batch: PythonOnly[Annotated[int, Within(1, 10_000)]] = 4  # frames of a step, at most
    # Radians in such a step; limits joints with short lever arms.
    largest_turn: PythonOnly[Turn] = 0.03
    # Frames that a clip shares with the next.
    overlap: PythonOnly[Annotated[int, Within(0, 5_000)]] = 16
    seed: Seed = 0  # seed of the order of frames

    command: ClassVar[str]  # command of these options, for error messages
    decay: ClassVar[float]  # final learning rates, relative to the initial ones

    def __post_init__(self) -> None:
        if not 2 * self.overlap < self.part:
            raise InputError(
                f"{self.command}: overlap must be less than half a part, "
                f"got overlap {self.overlap}, part {self.part}"
            )


@dataclass(frozen=True)
class Descent:
    """The result of an optimisation."""

    pose: Pose  # of all T frames; those without evidence stay as they were
    prior: PosePrior  # as inferred last
    variances: Tensor  # (T, J + 3) Corrections.variances; NaN in frames that stayed


def descend(
    evidence: Evidence,
    start: Pose,
    arms: Tensor,
    options: DescentOptions,
    progress: Progress | None = None,
    filled_in: Sequence[int] = (),
    try_uncorrected: bool = False,
    known_errors: Mapping[str, Stage1ErrorModel] | None = None,
) -> Descent:
    """Minimise eq. 1; the leaves ``evidence.shared`` are moved in place.

    Args:
        evidence: of a subset of the frames.
        start: poses of all T frames, which are corrected.
        arms: (J,) lever arms of the person's joints, metres.
        options: weights, passes, learning rates and the seed.
        progress: called as ``progress(done, total, loss=...)`` after every step.
        filled_in: frames without evidence, whose poses follow from the prior.
        try_uncorrected: start from ``start`` itself if it has a lower loss than the MAP estimate,
            which takes all jerky motion for errors.
        known_errors: of the estimator that made ``start``, by group of joints; None: inferred.
    """
    frames = sorted({*evidence.frames, *filled_in})
    stage1 = Stage1Poses.of(start, frames, evidence.camera)
    corrections = Corrections.map_estimate(stage1, evidence.anatomy, known_errors)
    if any(errors.lag for errors in (known_errors or {}).values()):
        shares = _lag_shares(evidence, frames, corrections)
        corrections = corrections.with_less_lag(shares)
    if try_uncorrected:
        corrections = _lowest_loss(evidence, frames, corrections, corrections.zeroed())
    adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
    seen = [i for i, k in enumerate(frames) if k not in set(filled_in)]
    batches = [[seen[i] for i in batch] for batch in _batches(len(seen), options)]
    first_inference = options.learn * len(batches) // options.passes
    weight, a_pass = EARLY_PRIOR_WEIGHT * options.prior_weight, len(batches) // options.passes
    for step, batch in enumerate(batches):
        if step in (first_inference, int(SECOND_INFERENCE * first_inference)):
            if step == first_inference:
                evidence.enable_details()
            corrections = corrections.with_updated_prior(*corrections.found())
            weight = options.prior_weight
            adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
        if (
            step >= first_inference
            and evidence.soles is not None
            and step % a_pass == first_inference % a_pass
        ):
            corrections.fit_ground(evidence.soles)
        loss = evidence.loss([frames[i] for i in batch], corrections.pose(batch))
        loss = loss + weight * corrections.energy(evidence.distance_shown) + evidence.energy()
        if step < int(CONSTANT_TURN_SHARE * first_inference) and not evidence.surface_known:
            loss = loss + options.prior_weight * corrections.constant_turn_energy()
        loss.backward()
        adam.step(options.decay ** (step / len(batches)))
        if progress is not None:
            progress(step + 1, len(batches), loss=float(loss.detach()))
    with torch.no_grad():
        found = corrections.pose(range(len(frames)))
        variances = torch.full((len(start), len(arms) + 3), torch.nan, dtype=torch.float64)
        variances[frames] = corrections.variances()
    return Descent(start.with_frames(frames, found), corrections.prior, variances)


@torch.no_grad()
def _lag_shares(evidence: Evidence, frames: list[int], map_estimate: Corrections) -> Tensor:
    """Return ``w`` of eq. 2 (n,); frames without evidence take it from their neighbours."""
    seen = [i for i, k in enumerate(frames) if k in set(evidence.frames)]
    loss = lambda i, corrections: float(evidence.loss([frames[i]], corrections.pose([i])))
    stage1 = map_estimate.zeroed()
    against = torch.tensor([loss(i, map_estimate) - loss(i, stage1) for i in seen]).clamp_min(0)
    shares = torch.exp(-(against / CONTRADICTION).square())
    return torch.from_numpy(np.interp(range(len(frames)), seen, shares)).float()


@torch.no_grad()
def _lowest_loss(evidence: Evidence, frames: list[int], *starts: Corrections) -> Corrections:
    """Return the start whose poses have the lowest loss."""
    seen = [i for i, k in enumerate(frames) if k in set(evidence.frames)]
    numbers = [frames[i] for i in seen]
    losses = [float(evidence.loss(numbers, corrections.pose(seen))) for corrections in starts]
    return starts[losses.index(min(losses))]


def worse_frames(
    frames: Iterable[int], before: Tensor, after: Tensor, digits: int = 3, margin: float = 0.0
) -> dict[int, str]:
    """Return the frames whose loss grew, each with a message.

    Args:
        frames: that are tested.
        before: (T,) losses.
        after: (T,) losses; NaN counts as grown.
        digits: of losses in messages.
        margin: by which a loss may grow.
    """
    return {
        k: f"its loss grew from {before[k]:.{digits}f} to {after[k]:.{digits}f}"
        for k in frames
        if not after[k] <= before[k] + margin
    }


def optimiser(
    corrections: Corrections,
    arms: Tensor,
    options: Steps,
    unseen: Sequence[int] = (),
    shared: Sequence[tuple[Tensor, float]] = (),
) -> VectorAdam:
    """Return the optimiser of corrections and of the leaves ``s``.

    Args:
        corrections: their leaves.
        arms: (J,) lever arms of the person's joints, metres.
        options: step sizes.
        unseen: joints that do not move.
        shared: the leaves ``s``, each with its learning rate.
    """
    # The three coordinates of a turn have step sizes of their own, together as long as one.
    turns = turn_rates(arms, options.step, options.largest_turn)[..., None] / 3**0.5
    turns[list(unseen)] = 0
    leaves = [(corrections.turns, turns), (corrections.moves, options.translation_lr)]
    tensors, rates = zip(*leaves, *shared, strict=True)
    return VectorAdam(tensors, rates)


def _batches(frames: int, options: DescentOptions) -> Iterator[list[int]]:
    """Yield the indices of every step's frames; each pass visits all frames in a random order."""
    generator = torch.Generator().manual_seed(options.seed)
    count = -(-frames // options.batch)
    for _ in range(options.passes):
        order = torch.randperm(frames, generator=generator).tolist()
        yield from (order[first::count] for first in range(count))
