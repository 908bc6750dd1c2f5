"""Adam with the rates of a fit: one group of parameters for each kind.

With the gradient g of a parameter x, and means m and v over steps,

1. m <- β1 m + (1 - β1) g,   v <- β2 v + (1 - β2) g²
2. x <- x - rate m̂ / (√v̂ + ε),   m̂ = m / (1 - β1^k),   v̂ = v / (1 - β2^k)   in step k

Gaussians that no frame shows, as in an armpit or on the back of a person who never turns, have a
hundredth of the gradient of others, all noise. With 3DGS's ε of 1e-15 they move as far as others:
they burst out of the surface once an arm is raised, and their colours wander. So ε is about a tenth
of the gradient of a Gaussian in plain view.

A move along the line of sight hardly changes a picture. If all pictures are from one side, that is
one axis in all of them, and noise along it moves Gaussians as far as pictures move them aside. So
for such people (``one_sided``) the coordinates of a place, or of a rotation, share one v, as in
the optimiser of poses (:mod:`gva_mi.pose.optimizer`):

3. v <- β2 v + (1 - β2) |g|²
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.core.same_bits import sqrt
from gva_mi.fit.lambert import Lambert
from gva_mi.fit.options import Rates

NOISE = {"means": 1e-5, "sh": 3e-7}  # ε
VECTORS = ("means", "quats")  # whose coordinates share a v, of one-sided people
TINY = 1e-15


def make_adam(
    avatar: Avatar, lambert: Lambert | None, rates: Rates, one_sided: bool = False
) -> torch.optim.Adam:
    """Make Adam with one named group, and one learning rate, for each kind of parameter.

    ``one_sided``: the pictures may show the person from one side only.
    """
    groups = [
        {"name": k, "params": [x], "lr": getattr(rates, k), "eps": NOISE.get(k, TINY)}
        for k, x in avatar.canonical.named_parameters()
    ]
    if avatar.options.residual.enabled:
        groups.append(
            {"name": "residual", "params": list(avatar.residual.parameters()), "lr": rates.residual}
        )
    groups.append({"name": "light", "params": [avatar.light], "lr": rates.light})
    if lambert is not None:
        groups.append({"name": "strength", "params": [lambert.strength], "lr": rates.strength})
    adam = AdamOfVectors if one_sided else torch.optim.Adam
    return adam(groups, lr=0.0, eps=TINY, fused=True)


class AdamOfVectors(torch.optim.Adam):
    """Adam with eq. 3 for the groups named in VECTORS, of one parameter (..., D) each."""

    @torch.no_grad()
    def step(self) -> None:
        """Take one step."""
        groups = [group for group in self.param_groups if group["name"] in VECTORS]
        gradients = [group["params"][0].grad for group in groups]
        for group in groups:
            group["params"][0].grad = None  # torch's step leaves such parameters alone
        super().step()
        for group, g in zip(groups, gradients, strict=True):
            (x,) = group["params"]
            x.grad = g
            if g is not None:
                self._descend(x, g, group)

    def _descend(self, x: Tensor, g: Tensor, group: dict) -> None:
        """Take a step of eq. 2 and 3."""
        state = self.state[x]
        if not state:
            state["step"] = torch.zeros(())
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(x), torch.zeros_like(x)
        state["step"] += 1
        m, v, k = state["exp_avg"], state["exp_avg_sq"], int(state["step"])
        b1, b2 = group["betas"]
        square = sum(coordinate.square() for coordinate in g.split(1, -1))
        m.mul_(b1).add_(g * (1 - b1))
        v.mul_(b2).add_(square * (1 - b2))
        x -= group["lr"] * (m / (1 - b1**k)) / (sqrt(v / (1 - b2**k)) + group["eps"])


def lower_rate_of_means(adam: torch.optim.Adam, rates: Rates, done: float) -> None:
    """Set the learning rate of the means, which falls exponentially; ``done`` from 0 to 1."""
    for group in adam.param_groups:
        if group["name"] == "means":
            group["lr"] = rates.means ** (1 - done) * rates.means_end**done
