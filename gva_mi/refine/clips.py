"""Cut a long video into overlapping clips that are refined separately, and join the results.

The clothes' displacement must be the same in all clips, and a clip that shows the person from one
side alone could not find it. So a long video is refined in two rounds:

1. *Skim*: short runs of frames, spread over the whole video, are refined together. Only the
   unknowns that all frames share are kept. Frames come in runs because the motion prior needs
   neighbours.
2. *Clips*: the shared unknowns stay fixed. Every clip then depends on its own frames alone, and
   clips can be refined at the same time on any number of machines, with the same result.

Near its ends a clip lacks the neighbours that would correct it. So both solutions are blended where
two clips overlap; each weight falls linearly toward the clip's own end:

    R_k = R_k^a exp(w_k log(R_k^a⁻¹ R_k^b)),    t_k = (1 - w_k) t_k^a + w_k t_k^b,
    w_k = (k - start_b + 1) / (overlap + 1)

The cut depends on the video's length alone, not on the number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.body.so3 import turns_between

SKIM_RUNS = 8  # runs of frames in a skim; chosen: eight sides of a person who turns once


def cut(frames: int, longest: int, overlap: int) -> list[range]:
    """Return clips of nearly equal length, at most ``longest``, that overlap by ``overlap``."""
    if frames <= longest:
        return [range(frames)]
    count = -(-(frames - overlap) // (longest - overlap))
    starts = [(frames - overlap) * i // count for i in range(count)]
    ends = [start + overlap for start in starts[1:]] + [frames]
    return [range(start, end) for start, end in zip(starts, ends, strict=True)]


def skim(frames: int, count: int) -> list[int]:
    """Return about ``count`` of the frames, in runs spread evenly over all of them."""
    length = max(1, count // SKIM_RUNS)
    if frames <= count or frames <= length * SKIM_RUNS:
        return list(range(frames))
    starts = [(frames - length) * i // (SKIM_RUNS - 1) for i in range(SKIM_RUNS)]
    return sorted({k for start in starts for k in range(start, start + length)})


def join(clips: Sequence[range], poses: Sequence[Pose]) -> Pose:
    """Join the poses of the clips that :func:`cut` made; return the poses of all frames."""
    whole = poses[0]
    for clip, other in zip(clips[1:], poses[1:], strict=True):
        ours, theirs = whole[clip.start :], other[: len(whole) - clip.start]
        weight = (torch.arange(len(ours)).to(ours.transl) + 1)[:, None] / (len(ours) + 1)
        between = Pose(
            _slerp(ours.rotations, theirs.rotations, weight[..., None]),
            torch.lerp(ours.transl, theirs.transl, weight),
            torch.lerp(ours.expression, theirs.expression, weight),
        )
        whole = Pose.cat([whole[: clip.start], between, other[len(ours) :]])
    return whole


def _slerp(a: Tensor, b: Tensor, weight: Tensor) -> Tensor:
    """Interpolate between two rotations (..., 3), axis-angle."""
    return turns_between(-a, weight * turns_between(a, b))
