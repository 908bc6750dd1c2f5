"""How much of each Gaussian the training frames show.

    1. w_k = Σ_p T_p α_p                       what it adds to frame k: pixels p, transmittance T
    2. s_k = w_k / (2π η √det Σ)               the share that is not hidden: over Σ_p α_p
    3. s   = Σ_k w_k s_k / Σ_k w_k             the same where it is seen: the mean over its pixels

with η its opacity and Σ its covariance in the picture. A Gaussian alone before the background has
s = 1. In a closed surface it is about 0.4, because neighbours overlap, whether one frame shows it
or all. In an armpit, between the fingers of a fist and under a skirt it is nearly 0.

No gradient holds such a Gaussian. Adam moves it by about its learning rate all the same, and others
drift to it and stay hidden. A raised arm would show them as flakes, so they do not carry the
surface of a re-initialisation (:mod:`gva_mi.avatar.reinit`), and in the end they go back to it:

    4. x ← x_0 + min(1, 2 s / HIDDEN) (x - x_0)

with x the place, the axes or the sizes of a Gaussian, and x_0 those that it was made with. Without
the 2, test frames lose 0.1 dB, and new poses gain less.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.avatar.reinit import HIDDEN
from gva_mi.body.pose import Pose
from gva_mi.fit.renders import DRAWN
from gva_mi.splat import Camera, Gaussians, Screen, render

FRAMES = 16  # that Gaussians are looked for in


def shown_shares(
    avatar: Avatar, poses: Callable[[int], Pose], cameras: Mapping[int, Camera]
) -> Tensor:
    """Return s (N,) of an avatar's Gaussians, from the poses and cameras of some frames."""
    total, shared = torch.zeros(2, len(avatar.canonical))
    for frame, camera in cameras.items():
        with torch.no_grad():
            gaussians = avatar(poses(frame))
        # The gradient of the sum of all pixels by a Gaussian's colour is w.
        colors = total.new_ones(len(total), 1).requires_grad_()
        screen = Screen()
        image = render(replace(gaussians, sh=None, colors=colors), camera, DRAWN, screen=screen)
        w = torch.autograd.grad(image.color.sum(), colors)[0][:, 0]
        xx, xy, yy = screen.conics.unbind(1)
        alone = 2 * math.pi * screen.opacities / (xx * yy - xy * xy).sqrt()
        total += w
        shared += torch.where(screen.visible, w * w / alone, 0)
    return shared / total.clamp_min(1e-12)


@torch.no_grad()
def put_back(canonical: CanonicalGaussians, made: Gaussians, shown: Tensor) -> None:
    """Put hidden Gaussians back to where they were made (eq. 4); ``shown`` (N,) is s."""
    kept = (2 * shown / HIDDEN).clamp(max=1)[:, None]
    for name, first in (
        ("means", made.means),
        ("quats", made.quats),
        ("log_scales", made.scales.log()),
    ):
        now = getattr(canonical, name)
        now.copy_(torch.lerp(first, now, kept))
