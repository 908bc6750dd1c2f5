"""Adam for vectors: one step size for a vector, not one for each of its coordinates.

    m ← β1 m + (1 - β1) g,     v ← β2 v + (1 - β2) |g|²,     x ← x - lr m̂ / (√v̂ + ε)

with ``|g|²`` over the last axis (Ling et al., *VectorAdam*, 2022). Adam proper moves every
coordinate by about its learning rate, however little the picture says about it: the twist of a
forearm, which is hardly seen, would drift as fast as its swing. VectorAdam keeps the direction of
the gradient, and its result does not depend on the axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

EPSILON = 1e-12


@dataclass
class _Moments:
    steps: int
    m: Tensor  # as the leaf
    v: Tensor  # (..., 1)


@dataclass
class VectorAdam:
    """Moves tensors (..., D) of vectors.

    A tensor without a gradient is left as it is, and so are its ``m`` and ``v``.

    Attributes:
        tensors: the leaves.
        rates: for each leaf its learning rate, a number or (..., 1) of the leaf's shape.
        betas: β1 and β2, how slowly ``m`` and ``v`` forget.
    """

    tensors: Sequence[Tensor]
    rates: Sequence[float | Tensor]
    betas: tuple[float, float] = (0.9, 0.99)
    _moments: dict[int, _Moments] = field(default_factory=dict, repr=False)

    def state(self) -> dict[int, tuple[int, Tensor, Tensor]]:
        """Steps, ``m`` and ``v`` of each leaf that was moved, by its place; for a checkpoint."""
        return {k: (moments.steps, moments.m, moments.v) for k, moments in self._moments.items()}

    def load_state(self, state: dict[int, tuple[int, Tensor, Tensor]]) -> None:
        """Go on from a :meth:`state`."""
        self._moments = {k: _Moments(*values) for k, values in state.items()}

    @torch.no_grad()
    def step(self, factor: float = 1.0) -> None:
        """One step of all leaves that have a gradient, which is then cleared.

        Args:
            factor: multiplies all learning rates, for a schedule.
        """
        beta1, beta2 = self.betas
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
            x -= factor * rate * m / (v.sqrt() + EPSILON)
            x.grad = None
