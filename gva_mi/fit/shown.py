"""How much of each Gaussian the training frames show.

    s_i = max_k  Σ_p T_kip α_kip / (2π η_i √det Σ_ki)

over frames k and pixels p, with T the transmittance before Gaussian i, α its alpha, and Σ its
covariance in the picture, so that the divisor is Σ_p α_kip. A Gaussian alone before the background
has s = 1, one of a closed surface about 0.4, because neighbours overlap. In an armpit, between the
fingers of a fist or under a skirt s is nearly 0.

No gradient holds such a Gaussian. Adam moves it by about its learning rate all the same, and others
drift to it and stay hidden. They must not carry the surface of a re-initialisation
(:mod:`gva_mi.avatar.reinit`): a raised arm would show them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.fit.renders import DRAWN
from gva_mi.splat import Camera, Screen, render

FRAMES = 16  # that Gaussians are looked for in


def shown_shares(
    avatar: Avatar, poses: Callable[[int], Pose], cameras: Mapping[int, Camera]
) -> Tensor:
    """Return s (N,) of an avatar's Gaussians, from the poses and cameras of some frames."""
    found = torch.zeros(len(avatar.canonical))
    for frame, camera in cameras.items():
        with torch.no_grad():
            gaussians = avatar(poses(frame))
        # The gradient of the sum of all pixels by a Gaussian's colour is the sum of its T α.
        colors = found.new_ones(len(found), 1).requires_grad_()
        screen = Screen()
        image = render(replace(gaussians, sh=None, colors=colors), camera, DRAWN, screen=screen)
        (weight,) = torch.autograd.grad(image.color.sum(), colors)
        xx, xy, yy = screen.conics.unbind(1)
        alone = 2 * math.pi * screen.opacities / (xx * yy - xy * xy).sqrt()
        found = torch.where(screen.visible, torch.maximum(found, weight[:, 0] / alone), found)
    return found
