"""How people move: at rest, or as fast as pictures show it.

From one frame to the next a joint turns by ``Δ_k``. Most of the time, most joints rest; then one
moves for a while, here slowly, there fast. How far it gets, ``s_k`` for a frame, is no constant:

1. ``s_k² = mean over the frames around of |e_l|² / d``,   ``e_l = (Δ_l + ... + Δ_l+h-1) / √h``

that of a random walk that gets as far in ``h`` frames, in which what is left of errors counts
little. It is found twice: from stage 1, with a median instead of the mean, for a leg that is lost
in some frames does not move, and for several ``h``, since beside white errors slow motions show
over many frames alone; and from refined poses, from the coordinate that pictures show. A joint that
turns sideways may turn in depth as well, and one that is at rest sideways is taken to be at rest.

Given ``s_k``, a motion is as probable as Student's t distribution says, so that a single jump costs
the logarithm of its size and not its square:

2. ``E = Σ_k (ν + d) / 2 · log(1 + |Δ_k|² / (ν s_k²))``

The pelvis, on which everything hangs, may turn and travel steadily: there ``Δ`` is the change of
its steps, ``Δ_k+1 - Δ_k``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.pose.noise import FREEDOM, median_of_square

SPAN = 8  # h, frames
SPANS = (4, 8, 16)  # h for stage 1
AROUND = 4.0  # frames to each side, standard deviation of the window of eq. 1
MEDIAN_AROUND = 10  # frames to each side, of the median


def excursions(changes: Tensor, span: int) -> Tensor:
    """``e`` of eq. 1 (n, ...) of changes ``Δ`` (n, ...), centred; over fewer frames at the ends."""
    total = torch.cat([torch.zeros_like(changes[:1]), changes.cumsum(0)])
    n = len(changes)
    first = (torch.arange(n) - span // 2).clamp(0, max(n - span, 0))
    last = (first + span).clamp(max=n)
    frames = (last - first).view(-1, *[1] * (changes.ndim - 1))
    return (total[last] - total[first]) / frames.sqrt()


def usual_square(e: Tensor) -> Tensor:
    """Eq. 1 with a median: ``s²`` (n, C) of excursions (n, C, d), a few of which are false."""
    square = e.square().sum(-1) / median_of_square(e.shape[-1])
    around = [
        square[max(0, k - MEDIAN_AROUND) : k + MEDIAN_AROUND + 1].median(0).values
        for k in range(len(square))
    ]
    return torch.stack(around) if around else square


def mean_square(square: Tensor, times: Tensor) -> Tensor:
    """Eq. 1: ``s²`` (n, C) from the squares (n, C) of one coordinate of ``e``."""
    apart = (times[:, None] - times) / AROUND
    weights = torch.exp(-apart.square() / 2)
    return (weights / weights.sum(1, keepdim=True)) @ square


def cost(changes: Tensor, square_speed: Tensor) -> Tensor:
    """Eq. 2 before it is summed (...), of ``Δ`` (..., d) and ``s²`` (...)."""
    x = changes.square().sum(-1) / (FREEDOM * square_speed)
    return (FREEDOM + changes.shape[-1]) / 2 * torch.log1p(x)


def stiffness(changes: Tensor, square_speed: Tensor) -> Tensor:
    """The weight ``w`` of ``w |Δ|² / 2`` that has the slope of eq. 2 at ``Δ``."""
    x = changes.square().sum(-1) / (FREEDOM * square_speed)
    return (FREEDOM + changes.shape[-1]) / (FREEDOM * square_speed * (1 + x))
