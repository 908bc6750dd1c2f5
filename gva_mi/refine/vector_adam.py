"""The optimiser of poses, and the learning rates of joints.

Learning rates of joints are divided by their lever arms, so that a step moves the surface by about
the same distance whichever joint turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from gva_mi.body.pose import JAW_AND_EYES
from gva_mi.body.smplx import Rest
from gva_mi.core.cpu import sqrt

# β1 and β2, the decay of ``m`` and ``v``. Chosen: β1 is Adam's, and β2 averages over a hundred
# steps, where Adam's 0.999 averages over a thousand.
MOMENT_DECAY = (0.9, 0.99)
EPSILON = 1e-12  # ε, of a gradient's length; chosen: a shorter one counts as zero


@dataclass
class _Moments:
    steps: int
    m: Tensor  # shape of the leaf
    v: Tensor  # (..., 1)


@dataclass
class VectorAdam:
    """Adam with one step size per vector; a tensor without a gradient does not move.

        m ← β1 m + (1 - β1) g,     v ← β2 v + (1 - β2) |g|²,     x ← x - lr m̂ / (√v̂ + ε)

    with ``|g|²`` over the last axis (Ling et al., *VectorAdam*, 2022). Adam moves every coordinate
    by about its learning rate, however weak its gradient: the twist of a forearm, which is hardly
    visible, would drift as fast as its swing. VectorAdam keeps the direction of the gradient, so
    its result does not depend on the axes.

    Attributes:
        tensors: the leaves.
        rates: the learning rate of each leaf, a number or (..., 1) of the leaf's shape.
    """

    tensors: Sequence[Tensor]
    rates: Sequence[float | Tensor]
    _moments: dict[int, _Moments] = field(default_factory=dict, repr=False)

    def state(self) -> dict[int, tuple[int, Tensor, Tensor]]:
        """Return steps, ``m`` and ``v`` of each moved leaf, by its index, for a checkpoint."""
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
    """Return the quadratic mean distance (J,) of joints to the vertices that they turn, metres.

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
    """Return the learning rates (J, 1) of joint rotations, radians; zero for jaw and eyes.

    Masks and normals of this size do not show jaw and eyes, so they are never turned.

    Args:
        arms: (J,) lever arms, metres.
        step: metres that a step moves the vertices that turn with the joint.
        largest_turn: radians; no joint turns more in a step, however short its lever arm.
    """
    rates = (step / arms).clamp_max(largest_turn)[:, None]
    rates[JAW_AND_EYES] = 0
    return rates
