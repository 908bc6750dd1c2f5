"""How people move: at rest, or as fast as pictures show it.

From one frame to the next a joint turns by ``Δ_k``. Most of the time, most joints rest; then one
moves fast for a while. How fast, ``s_k``, is no constant:

1. ``s_k² = mean over the frames around of |v_l|² / 3``,   ``v_l = log(R_lᵀ R_l+h) / h``

over ``h`` frames, in which what is left of errors counts little. It is found twice: from stage 1,
with a median instead of the mean, for a leg that is lost in some frames does not move, and at
several ``h``, for slow motions show beside white errors over many frames alone; and from refined
poses, from the coordinate that pictures show. A joint that turns sideways may turn in depth
as well, and one that is at rest sideways is taken to be at rest.

Given ``s_k``, a motion is as probable as Student's t distribution says, so that a single jump costs
the logarithm of its size and not its square:

2. ``E = Σ_k (ν + d) / 2 · log(1 + |Δ_k|² / (ν s_k² dt_k))``,   ``dt_k = t_k+1 - t_k``

The pelvis, on which everything hangs, may turn and travel steadily: there ``Δ`` is the change of
its steps, ``Δ_k+1 - Δ_k``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.pose.noise import FREEDOM, median_of_square

SPAN = 4  # h, frames
SPANS = (4, 8, 16)  # of stage 1
AROUND = 4.0  # frames to each side, standard deviation of the window of eq. 1
MEDIAN_AROUND = 10  # frames to each side, of the median


def over_span(steps: Tensor, span: int) -> Tensor:
    """Mean steps over ``span`` of them (n, ...), centred; fewer at the ends. From steps (n, ...)."""
    total = torch.cat([torch.zeros_like(steps[:1]), steps.cumsum(0)])
    n = len(steps)
    first = (torch.arange(n) - span // 2).clamp(0, n)
    last = (first + span).clamp(max=n)
    first = (last - span).clamp(min=0)
    length = (last - first).view(-1, *[1] * (steps.ndim - 1))
    return (total[last] - total[first]) / length


def usual_square(velocities: Tensor) -> Tensor:
    """Eq. 1 with a median: ``s²`` (n, C) of velocities (n, C, d), a few of which are false."""
    square = velocities.square().sum(-1) / median_of_square(velocities.shape[-1])
    around = [
        square[max(0, k - MEDIAN_AROUND) : k + MEDIAN_AROUND + 1].median(0).values
        for k in range(len(square))
    ]
    return torch.stack(around) if around else square


def mean_square(square: Tensor, times: Tensor) -> Tensor:
    """Eq. 1: ``s²`` (n, J) from the squares (n, J) of one coordinate's velocity."""
    apart = (times[:, None] - times) / AROUND
    weights = torch.exp(-apart.square() / 2)
    return (weights / weights.sum(1, keepdim=True)) @ square


def cost(changes: Tensor, square_scale: Tensor) -> Tensor:
    """Eq. 2 before it is summed (...), of ``Δ`` (..., d) and ``s² dt`` (...)."""
    x = changes.square().sum(-1) / (FREEDOM * square_scale)
    return (FREEDOM + changes.shape[-1]) / 2 * torch.log1p(x)


def stiffness(changes: Tensor, square_scale: Tensor) -> Tensor:
    """The weight ``w`` of ``w |Δ|² / 2`` that has the slope of eq. 2 at ``Δ``."""
    x = changes.square().sum(-1) / (FREEDOM * square_scale)
    return (FREEDOM + changes.shape[-1]) / (FREEDOM * square_scale * (1 + x))
