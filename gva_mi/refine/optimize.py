"""Optimise the poses of many frames together, on evidence and prior.

Unknown are the corrections of the poses, turns ``δ`` and shifts ``τ`` of every frame
(:mod:`gva_mi.refine.corrections`), and ``s``, other unknowns of the evidence that all frames share.
A step takes a random batch of frames ``k``, so that a pass visits every frame once, and follows the
gradient of

1. ``L(δ, τ, s) = mean_k L_k(pose_k(δ, τ), s) + E(δ, τ) + E(s)``

with :class:`VectorAdam`, whose learning rates fall from ``r`` to ``decay · r``.

``E(δ, τ)`` is the prior. It is first estimated from stage 1 alone, and has a low weight: otherwise
small motions would be taken for errors, and the corrections would show no more than the guess.
After ``learn`` passes the error model and the speed of the motion are inferred from the corrections
that the images made, the prior gets its full weight, and details such as hands are compared. Half
as many passes later the prior is inferred once more.

If the clothes are unknown, turns that are the same in all frames are penalised during the first
half of the ``learn`` passes. Otherwise the clothes' surface would adapt to them, and keep them. If
the estimator's errors are known, so is their mean, and the prior penalises these turns throughout.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Protocol

import torch
from torch import Tensor

from gva_mi.body.pose import JAW_AND_EYES, Pose
from gva_mi.body.smplx import Rest
from gva_mi.core.console import Progress
from gva_mi.core.cpu import sqrt
from gva_mi.core.errors import InputError
from gva_mi.core.options import Metres, PythonOnly, Seed, Turn, Within
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.error_model import Stage1ErrorModel
from gva_mi.prior.ground import Soles
from gva_mi.prior.inference import PosePrior
from gva_mi.prior.stage1_poses import Stage1
from gva_mi.refine.corrections import Corrections
from gva_mi.splat import Camera

EARLY_PRIOR_WEIGHT = 0.2  # weight of the prior before it is inferred from corrections
SECOND_INFERENCE = 1.5  # the prior is inferred again after this many times the ``learn`` passes
HELD_SHARE = 0.5  # share of the ``learn`` passes that penalise turns shared by all frames

# Types of options that several fits of poses have, with their ranges.
Passes = Annotated[int, Within(1, 10_000)]
Learn = Annotated[int, Within(0, 10_000)]
PriorWeight = Annotated[float, Within(0, 1e6, "low")]
PartFrames = Annotated[int, Within(1, 10_000)]
# Pixels of the person's longer side in the images that are compared.
PersonSize = Annotated[int, Within(1, 4096)]
Faces = Annotated[int, Within(500, 1_000_000)]  # a body with fewer triangles has no hands left
MOMENT_DECAY, EPSILON = (0.9, 0.99), 1e-12  # β1 and β2, the decay of ``m`` and ``v``; ε


class Evidence(Protocol):
    """Comparison of a clip's poses with its frames.

    Attributes:
        frames: numbers of the frames that have evidence.
        camera: of one of them; corrections are made along its axes.
        anatomy: of the person's joints.
        soles: of the person, for the current shape; None: no ground term.
        shared: the leaves ``s``, each with its learning rate; often none.
        distance_shown: whether it shows how far away the person stands.
        surface_known: whether the person's clothes are known.
        unseen: joints that it does not show yet, whose turns stay at the MAP estimate.
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
    prior_weight: PriorWeight  # weight of the prior, in units of L_k per prior_weight
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


def descend(
    evidence: Evidence,
    start: Pose,
    arms: Tensor,
    options: DescentOptions,
    progress: Progress | None = None,
    following: Sequence[int] = (),
    try_uncorrected: bool = False,
    errors: Mapping[str, Stage1ErrorModel] | None = None,
) -> Descent:
    """Minimise eq. 1; the leaves ``evidence.shared`` are moved in place.

    Args:
        evidence: of some of the frames.
        start: poses of all T frames, which are corrected.
        arms: (J,) lever arms of the person's joints, metres.
        options: weights, passes, learning rates and the seed.
        progress: called as ``progress(done, total, loss=...)`` after every step.
        following: frames without evidence, whose poses follow from the prior.
        try_uncorrected: start from ``start`` itself if it has a lower loss than the MAP estimate,
            which takes all jerky motion for errors.
        errors: of the estimator that made ``start``, by group of joints; None: inferred.
    """
    frames = sorted({*evidence.frames, *following})
    stage1 = Stage1.of(start, frames, evidence.camera)
    corrections = Corrections.map_estimate(stage1, evidence.anatomy, errors)
    if try_uncorrected:
        corrections = _better(evidence, frames, corrections, corrections.zeroed())
    adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
    seen = [i for i, k in enumerate(frames) if k not in set(following)]
    batches = [[seen[i] for i in batch] for batch in _batches(len(seen), options)]
    learnt = options.learn * len(batches) // options.passes
    weight, a_pass = EARLY_PRIOR_WEIGHT * options.prior_weight, len(batches) // options.passes
    for step, batch in enumerate(batches):
        if step in (learnt, int(SECOND_INFERENCE * learnt)):
            if step == learnt:
                evidence.enable_details()
            corrections, weight = (
                corrections.with_updated_prior(*corrections.found()),
                options.prior_weight,
            )
            adam = optimiser(corrections, arms, options, evidence.unseen, evidence.shared)
        if step >= learnt and evidence.soles is not None and step % a_pass == learnt % a_pass:
            corrections.fit_ground(evidence.soles)
        loss = evidence.loss([frames[i] for i in batch], corrections.pose(batch))
        loss = loss + weight * corrections.energy(evidence.distance_shown) + evidence.energy()
        if step < int(HELD_SHARE * learnt) and not evidence.surface_known:
            loss = loss + options.prior_weight * corrections.constant_turn_energy()
        loss.backward()
        adam.step(options.decay ** (step / len(batches)))
        if progress is not None:
            progress(step + 1, len(batches), loss=float(loss.detach()))
    with torch.no_grad():
        found = corrections.pose(range(len(frames)))
    return Descent(start.with_frames(frames, found), corrections.prior)


@torch.no_grad()
def _better(evidence: Evidence, frames: list[int], *starts: Corrections) -> Corrections:
    """Return the corrections of the lowest loss."""
    seen = [i for i, k in enumerate(frames) if k in set(evidence.frames)]
    numbers = [frames[i] for i in seen]
    losses = [float(evidence.loss(numbers, corrections.pose(seen))) for corrections in starts]
    return starts[losses.index(min(losses))]


def worse_frames(
    frames: Iterable[int], before: Tensor, after: Tensor, digits: int = 3, margin: float = 0.0
) -> dict[int, str]:
    """Return which of some frames have a larger loss (T,) after than before, each with a message.

    NaN counts as larger; losses in the message have so many digits; by ``margin`` they may grow.
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
    """Yield the indices of every step's frames: each pass shuffles all of them and deals them."""
    generator = torch.Generator().manual_seed(options.seed)
    count = -(-frames // options.batch)
    for _ in range(options.passes):
        order = torch.randperm(frames, generator=generator).tolist()
        yield from (order[first::count] for first in range(count))


@dataclass
class _Moments:
    steps: int
    m: Tensor  # shape of the leaf
    v: Tensor  # (..., 1)


@dataclass
class VectorAdam:
    """Adam with one step size per vector; a tensor without a gradient stays as it is.

        m ← β1 m + (1 - β1) g,     v ← β2 v + (1 - β2) |g|²,     x ← x - lr m̂ / (√v̂ + ε)

    with ``|g|²`` over the last axis (Ling et al., *VectorAdam*, 2022). Adam moves every coordinate
    by about its learning rate, however weak its gradient: the twist of a forearm, which is hardly
    visible, would drift as fast as its swing. VectorAdam keeps the direction of the gradient, so
    its result does not depend on the axes.

    Learning rates of joints are divided by their lever arms, so that a step moves the surface by
    about the same distance whichever joint turns.

    Attributes:
        tensors: the leaves.
        rates: the learning rate of each leaf, a number or (..., 1) of the leaf's shape.
    """

    tensors: Sequence[Tensor]
    rates: Sequence[float | Tensor]
    _moments: dict[int, _Moments] = field(default_factory=dict, repr=False)

    def state(self) -> dict[int, tuple[int, Tensor, Tensor]]:
        """Steps, ``m`` and ``v`` of each leaf that was moved, by its index; for a checkpoint."""
        return {k: (moments.steps, moments.m, moments.v) for k, moments in self._moments.items()}

    def load_state(self, state: dict[int, tuple[int, Tensor, Tensor]]) -> None:
        """Continue from a :meth:`state`."""
        self._moments = {k: _Moments(*values) for k, values in state.items()}

    @torch.no_grad()
    def step(self, factor: float = 1.0) -> None:
        """Move all leaves that have a gradient, and clear it; ``factor`` scales all rates."""
        beta1, beta2 = MOMENT_DECAY
        for number, (x, rate) in enumerate(zip(self.tensors, self.rates, strict=True)):
            if x.grad is None:
                continue
            if number not in self._moments:
                rows = torch.zeros_like(x[..., :1])
                self._moments[number] = _Moments(0, torch.zeros_like(x), rows)
            state = self._moments[number]
            state.steps += 1
            state.m.mul_(beta1).add_(x.grad, alpha=1 - beta1)
            state.v.mul_(beta2).add_(x.grad.square().sum(-1, keepdim=True), alpha=1 - beta2)
            m = state.m / (1 - beta1**state.steps)
            v = state.v / (1 - beta2**state.steps)
            x -= factor * rate * m / (sqrt(v) + EPSILON)
            x.grad = None


def lever_arms(rest: Rest, weights: Tensor, parents: Sequence[int]) -> Tensor:
    """Quadratic mean distance (J,) between a joint and the vertices that turn with it, metres.

    Args:
        rest: the person's vertices (V, 3) and joints (J, 3) in the rest pose.
        weights: (V, J) skinning weights.
        parents: of the joints, -1 for the root.
    """
    moved = weights.clone()
    for joint in reversed(range(1, len(parents))):
        moved[:, parents[joint]] += moved[:, joint]
    square = (rest.vertices[:, None] - rest.joints).square().sum(-1)
    return sqrt((moved * square).sum(0) / moved.sum(0).clamp_min(1e-6))


def turn_rates(arms: Tensor, step: float, largest_turn: float) -> Tensor:
    """Learning rates (J, 1) of joint rotations, radians; zero for jaw and eyes.

    Masks and normals of this size do not show jaw and eyes, so they are never turned.

    Args:
        arms: (J,) lever arms, metres.
        step: metres that a step moves what turns with the joint.
        largest_turn: radians; no joint turns more in a step, however short its lever arm.
    """
    rates = (step / arms).clamp_max(largest_turn)[:, None]
    rates[JAW_AND_EYES] = 0
    return rates
