"""Adam (Kingma and Ba 2015) for the leaves of a fit, with one learning rate and epsilon per group.

    m ← β1 m + (1 - β1) g,     v ← β2 v + (1 - β2) g²,     x ← x - lr m̂ / (√v̂ + ε)

It calls torch's fused kernel and has the bits of ``torch.optim.Adam(fused=True)``. That class
imports torch's compiler, which takes 1.6 s, and makes every later call of ``render`` slower.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

BETAS = (0.9, 0.999)  # β1, β2


@dataclass
class Group:
    """Leaves that share a learning rate.

    Attributes:
        name: of the kind of parameter.
        params: the leaves.
        lr: learning rate, in units of the leaves.
        eps: ε, in units of their gradients.
    """

    name: str
    params: list[Tensor]
    lr: float
    eps: float = 1e-15


class Adam:
    """Adam on groups of leaves; a leaf without a gradient stays as it is.

    Attributes:
        groups: the leaves.
        state: ``step`` (), ``exp_avg`` and ``exp_avg_sq`` of each leaf that was moved, the last two
            of the leaf's shape.
    """

    def __init__(self, groups: list[Group]) -> None:
        self.groups = groups
        self.state: dict[Tensor, dict[str, Tensor]] = {}

    @torch.no_grad()
    def step(self) -> None:
        """Move all leaves that have a gradient, and clear it."""
        beta1, beta2 = BETAS
        for group in self.groups:
            moved = [x for x in group.params if x.grad is not None]
            if not moved:
                continue
            states = [self.state.setdefault(x, {}) for x in moved]
            for x, state in zip(moved, states, strict=True):
                if not state:
                    state |= {"step": torch.zeros(()), "exp_avg": torch.zeros_like(x)}
                    state["exp_avg_sq"] = torch.zeros_like(x)
            steps, m, v = ([s[k] for s in states] for k in ("step", "exp_avg", "exp_avg_sq"))
            torch._foreach_add_(steps, 1)
            torch._fused_adam_(
                moved,
                [x.grad for x in moved],
                m,
                v,
                [],
                steps,
                lr=group.lr,
                beta1=beta1,
                beta2=beta2,
                weight_decay=0.0,
                eps=group.eps,
                amsgrad=False,
                maximize=False,
            )
            for x in moved:
                x.grad = None

    def state_dict(self) -> dict[int, dict[str, Tensor]]:
        """Return the state of each leaf that was moved, by its place among all leaves."""
        return {k: self.state[x] for k, x in enumerate(self._leaves()) if x in self.state}

    def load_state_dict(self, state: dict[int, dict[str, Any]]) -> None:
        """Continue from a :meth:`state_dict`."""
        self.state = {x: state[k] for k, x in enumerate(self._leaves()) if k in state}

    def _leaves(self) -> Iterator[Tensor]:
        return (x for group in self.groups for x in group.params)
