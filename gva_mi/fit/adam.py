"""Adam with the rates of a fit: one group of parameters for each kind."""

from __future__ import annotations

import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.fit.lambert import Lambert
from gva_mi.fit.options import Rates

# Adam's epsilon: about a tenth of the gradient of a Gaussian in plain view. Gaussians that no frame
# shows, as in an armpit or on the back of a person who never turns, have a hundredth of it, all
# noise. With the 1e-15 of 3DGS they move as far as others and burst out of the surface once an arm
# is raised, and their colours wander.
NOISE = {"means": 1e-5, "sh": 3e-7}
TINY = 1e-15


def make_adam(avatar: Avatar, lambert: Lambert | None, rates: Rates) -> torch.optim.Adam:
    """Make Adam with one named group, and one learning rate, for each kind of parameter."""
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
    return torch.optim.Adam(groups, lr=0.0, eps=TINY, fused=True)


def lower_rate_of_means(adam: torch.optim.Adam, rates: Rates, done: float) -> None:
    """Set the learning rate of the means, which falls exponentially; ``done`` from 0 to 1."""
    for group in adam.param_groups:
        if group["name"] == "means":
            group["lr"] = rates.means ** (1 - done) * rates.means_end**done
