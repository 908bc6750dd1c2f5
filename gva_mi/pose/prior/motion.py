"""Motion model: joints rest, or move at the speed that images show.

From one frame to the next a joint turns by ``Δ_k``. Most joints rest most of the time; then one
moves for a while, slowly or fast. So the speed ``s_k`` is estimated around every frame:

1. ``s_k² = mean over the frames around of |e_l|² / d``,   ``e_l = (Δ_l + ... + Δ_l+h-1) / √h``

that of a random walk that gets as far in ``h`` frames, which suppresses remaining errors. It is
estimated twice: from stage 1, with a median that ignores outliers and for several ``h``, because
slow motions exceed white errors over many frames only; and from corrected poses, from the
coordinate that images show. Turns in depth are taken to be as fast as those seen sideways.

A known estimator that smooths its poses has neither outliers nor white errors. There the mean over
the frames of stage 1 itself is ``s_k²``, and stays so: a median takes a short gesture for an
outlier, and a prior that has flattened it would find it slow.

Given ``s_k``, motions follow Student's t distribution, so a single jump costs the logarithm of its
size, and not its square:

2. ``E = Σ_k (ν + d) / 2 · log(1 + |Δ_k|² / (ν s_k²))``

The pelvis may turn and travel steadily: there ``Δ`` is the change of its steps, ``Δ_k+1 - Δ_k``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt
from gva_mi.pose.prior.error_model import FREEDOM, median_of_square

SPAN = 8  # h, frames
SPANS = (4, 8, 16)  # h for stage 1
AROUND = 4.0  # frames to each side, standard deviation of the window of eq. 1
MEDIAN_AROUND = 10  # frames to each side, of the median


def excursions(changes: Tensor, span: int) -> Tensor:
    """Return ``e`` (n, ...) of changes ``Δ`` (n, ...), centred; over fewer frames at the ends."""
    total = torch.cat([torch.zeros_like(changes[:1]), changes.cumsum(0)])
    n = len(changes)
    first = (torch.arange(n) - span // 2).clamp(0, max(n - span, 0))
    last = (first + span).clamp(max=n)
    frames = (last - first).view(-1, *[1] * (changes.ndim - 1))
    return (total[last] - total[first]) / sqrt(frames)


def usual_square(e: Tensor) -> Tensor:
    """Return eq. 1 with a median: ``s²`` (n, C) of excursions (n, C, d) with outliers."""
    square = e.square().sum(-1) / median_of_square(e.shape[-1])
    around = [
        square[max(0, k - MEDIAN_AROUND) : k + MEDIAN_AROUND + 1].median(0).values
        for k in range(len(square))
    ]
    return torch.stack(around) if around else square


def mean_speed(changes: Tensor, times: Tensor) -> Tensor:
    """Return eq. 1: ``s²`` (n, C) of changes (n, C, ...) at times (n,)."""
    return mean_square(excursions(changes, SPAN).square().mean(-1), times.float())


def mean_square(square: Tensor, times: Tensor) -> Tensor:
    """Return eq. 1: ``s²`` (n, C) from the squares (n, C) of one coordinate of ``e``."""
    apart = (times[:, None] - times) / AROUND
    weights = torch.exp(-apart.square() / 2)
    return (weights / weights.sum(1, keepdim=True)) @ square


def cost(changes: Tensor, square_speed: Tensor) -> Tensor:
    """Return eq. 2 before it is summed (...), of ``Δ`` (..., d) and ``s²`` (...)."""
    x = changes.square().sum(-1) / (FREEDOM * square_speed)
    return (FREEDOM + changes.shape[-1]) / 2 * torch.log1p(x)


def stiffness(changes: Tensor, square_speed: Tensor) -> Tensor:
    """Return the weight ``w`` of ``w |Δ|² / 2`` that has the slope of eq. 2 at ``Δ``."""
    x = changes.square().sum(-1) / (FREEDOM * square_speed)
    return (FREEDOM + changes.shape[-1]) / (FREEDOM * square_speed * (1 + x))
