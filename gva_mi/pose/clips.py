"""A long video cut into overlapping parts that are refined apart, and joined again.

What all frames share, the displacement that stands for the clothes, must not differ from part to
part, and a part that shows the person from one side alone could not tell it. So a long video is
refined in two rounds:

1. *Skim*: some short runs of frames, spread over the whole video, are refined together, as a short
   video would be. Of what is found only the shared is kept. Runs, not single frames, because the
   pull between neighbours needs neighbours.
2. *Parts*: what is shared rests, so that every part depends on its own frames alone, and parts can
   be refined at the same time on any number of machines, with the same result.

Neighbouring parts overlap. At its ends a part has no neighbour in time to lean on, so that where
two overlap, both solutions are blended, the weight of each falling linearly to its own end:

    R_k = R_k^a exp(w_k log(R_k^a⁻¹ R_k^b)),    t_k = (1 - w_k) t_k^a + w_k t_k^b,
    w_k = (k - start_b + 1) / (overlap + 1)

The cut depends on the video's length alone, not on the number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence

import roma
import torch
from torch import Tensor

RUNS = 8  # of the skim: a person who turns once is seen from eight sides


def cut(frames: int, longest: int, overlap: int) -> list[range]:
    """Parts of nearly equal length, at most ``longest``, each sharing ``overlap`` with the next."""
    if frames <= longest:
        return [range(frames)]
    count = -(-(frames - overlap) // (longest - overlap))
    starts = [(frames - overlap) * i // count for i in range(count)]
    ends = [start + overlap for start in starts[1:]] + [frames]
    return [range(start, end) for start, end in zip(starts, ends, strict=True)]


def skim(frames: int, count: int) -> list[int]:
    """About ``count`` of the frames, in runs spread evenly over all of them."""
    length = max(1, count // RUNS)
    if frames <= count or frames <= length * RUNS:
        return list(range(frames))
    starts = [(frames - length) * i // (RUNS - 1) for i in range(RUNS)]
    return sorted({k for start in starts for k in range(start, start + length)})


def join(
    parts: Sequence[range], rotations: Sequence[Tensor], transl: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """One sequence from those of the parts.

    Args:
        parts: as :func:`cut` gives them.
        rotations: of each part, (frames of the part, 55, 3) axis-angle.
        transl: of each part, (frames of the part, 3).

    Returns:
        (T, 55, 3) and (T, 3).
    """
    R, t = rotations[0], transl[0]
    for part, R_next, t_next in zip(parts[1:], rotations[1:], transl[1:], strict=True):
        shared = len(R) - part.start
        weight = (torch.arange(shared, dtype=t.dtype) + 1)[:, None] / (shared + 1)
        between = _slerp(R[part.start :], R_next[:shared], weight[..., None])
        R = torch.cat([R[: part.start], between, R_next[shared:]])
        across = torch.lerp(t[part.start :], t_next[:shared], weight)
        t = torch.cat([t[: part.start], across, t_next[shared:]])
    return R, t


def _slerp(a: Tensor, b: Tensor, weight: Tensor) -> Tensor:
    """The rotation (..., 3) on the way from ``a`` to ``b``, axis-angle."""
    way = roma.rotvec_composition([roma.rotvec_inverse(a), b])
    return roma.rotvec_composition([a, weight * way])
