"""Adaptive density control: clone, split and prune Gaussians in the rest pose, as 3DGS does.

1. g_i     mean, over the views that show Gaussian i, of |dL/d(u, v)|; the unit is half the side of
           a square as large as the person's box, whatever the size of the picture
2. clone   where g_i > threshold and the Gaussian is small: something is missing beside it
3. split   where g_i > threshold and the Gaussian is large: it covers too much
4. prune   where it is nearly transparent, or larger than anything on a person

New Gaussians inherit the skinning weights of their parent, since they lie within its extent and the
fit binds them again from time to time. Adam's moments follow their rows; new rows start at zero.

Source: 3D Gaussian splatting (Kerbl et al., 2023, Sec. 5.2), with thresholds as in GART (Lei et
al., "GART: Gaussian Articulated Template Models", 2024).
"""

from __future__ import annotations

import math
from typing import Annotated

import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import BINDING, PARAMETERS, CanonicalGaussians, rotated
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.splat import Screen

SPLIT_SHRINK = 1.6  # factor by which the halves of a split are smaller, as in 3DGS
MIN_OPACITY = 0.05  # below it a Gaussian is removed; chosen by eye; 3DGS has 0.005
MAX_SCALE = 0.1  # metres; above it a Gaussian is removed; chosen: larger than any part of a person


@options_of("fit")
class DensifyOptions:
    """Thresholds of density control. Defaults follow 3DGS and GART.

    Example:
        >>> DensifyOptions().grad_threshold
        0.0002
    """

    # Of g: loss per half person, mean over the views that saw it.
    grad_threshold: PythonOnly[Annotated[float, Within(0, 1e6)]] = 2e-4
    # Metres; above it a Gaussian is split, below it is cloned.
    split_scale: PythonOnly[Annotated[float, Within(0, MAX_SCALE, "low")]] = 0.01
    # No growth beyond this many; the largest gradients come first.
    max_count: PythonOnly[Annotated[int, Within(0, 10_000_000)]] = 40_000


class ScreenGradients:
    """Sum over views of |dL/d(u, v)|, the loss's gradient with respect to screen positions.

    ``total`` (N,) is the sum, per half person, and ``views`` (N,) counts the views that showed a
    Gaussian.

    Example:
        Two Gaussians in a box of 100 × 100 pixels; the view shows only the first.

        >>> from types import SimpleNamespace
        >>> grad, visible = torch.tensor([[3e-4, 4e-4], [0, 0]]), torch.tensor([True, False])
        >>> screen = SimpleNamespace(grad=grad, visible=visible)  # as render fills a Screen
        >>> gradients = ScreenGradients(count=2)
        >>> gradients.add(screen, area=100 * 100)
        >>> gradients.mean()
        tensor([0.0250, 0.0000])
    """

    def __init__(self, count: int) -> None:
        self.total = torch.zeros(count)
        self.views = torch.zeros(count)

    @torch.no_grad()
    def add(self, screen: Screen, area: float) -> None:
        """Add one view after its backward pass; ``area`` is the person's box in it, pixels."""
        self.total += (area**0.5 / 2 * screen.grad.norm(dim=1)).to(self.total.dtype)
        self.views += screen.visible

    def mean(self) -> Tensor:
        """Return g of eq. 1, (N,); zero for Gaussians that no view has seen."""
        return self.total / self.views.clamp_min(1)


def densify(
    avatar: Avatar,
    optimizer: torch.optim.Optimizer,
    gradients: ScreenGradients,
    options: DensifyOptions = DensifyOptions(),  # noqa: B008 (frozen)
    generator: torch.Generator | None = None,
) -> None:
    """Run one round of density control; replaces ``avatar.canonical`` and the optimiser's state.

    The gradients have all views since the last round; start new ones afterwards. The generator
    draws the places of the halves of a split.

    Example:
        Ten of 500 Gaussians have a large gradient, and are cloned or split.

        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> optimizer = torch.optim.Adam(avatar.canonical.parameters())
        >>> gradients = ScreenGradients(count=500)
        >>> gradients.total[:10], gradients.views[:] = 1, 1
        >>> densify(avatar, optimizer, gradients, generator=torch.manual_seed(0))
        >>> len(avatar.canonical)
        510
    """
    G = avatar.canonical
    with torch.no_grad():
        wanted = gradients.mean().to(G.means.dtype)
        size = G.scales.amax(1)
        pruned = (G.opacities < MIN_OPACITY) | (size > MAX_SCALE)
        grows = (wanted > options.grad_threshold) & ~pruned
        room = max(0, options.max_count - int((~pruned).sum()))
        if int(grows.sum()) > room:  # both clone and split add exactly one
            order = torch.sort(wanted.where(grows, 0.0), descending=True, stable=True).indices
            grows = torch.zeros_like(grows).index_fill_(0, order[:room], True)
        cloned, split = grows & (size <= options.split_scale), grows & (size > options.split_scale)

        kept = torch.nonzero(~pruned & ~split).flatten()
        clones, halves = (torch.nonzero(x).flatten() for x in (cloned, split))
        parents = torch.cat([kept, clones, halves, halves])
        values = {name: getattr(G, name)[parents] for name in PARAMETERS}
        new = slice(len(kept) + len(clones), None)
        drawn = torch.randn(2 * len(halves), 3, generator=generator, dtype=G.means.dtype)
        drawn = drawn * values["log_scales"][new].exp()
        values["means"][new] += rotated(values["quats"][new], drawn)
        values["log_scales"][new] -= math.log(SPLIT_SHRINK)
        binding = {name: getattr(G, name)[parents] for name in BINDING}
        canonical = CanonicalGaussians(**values, **binding)
    replace_gaussians(avatar, optimizer, canonical, parents, inherited=len(kept))


def replace_gaussians(
    avatar: Avatar,
    optimizer: torch.optim.Optimizer,
    canonical: CanonicalGaussians,
    parents: Tensor | None = None,
    inherited: int = 0,
) -> None:
    """Replace the Gaussians of an avatar and of its optimiser.

    ``parents`` (N,) are the old rows of the new ones; None: Adam starts afresh. The first
    ``inherited`` rows keep the moments of their parents; the others start with zero moments.

    Example:
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> optimizer, G = torch.optim.Adam(avatar.canonical.parameters()), avatar.canonical
        >>> first = {name: getattr(G, name)[:400].detach() for name in (*PARAMETERS, *BINDING)}
        >>> replace_gaussians(avatar, optimizer, CanonicalGaussians(**first))
        >>> len(avatar.canonical), len(optimizer.param_groups[0]["params"][0])
        (400, 400)
    """
    old = avatar.canonical
    for name in PARAMETERS:
        before, after = getattr(old, name), getattr(canonical, name)
        after.requires_grad_(before.requires_grad)
        for group in optimizer.param_groups:
            group["params"] = [after if p is before else p for p in group["params"]]
        state = optimizer.state.pop(before, None)
        if state is None or parents is None:
            continue
        for key, value in state.items():
            if torch.is_tensor(value) and value.shape == before.shape:
                carried = value[parents]
                carried[inherited:] = 0
                state[key] = carried
        optimizer.state[after] = state
    avatar.canonical = canonical
