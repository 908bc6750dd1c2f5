"""A long video cut into overlapping clips that are refined apart, and joined again.

What all frames share, the displacement that stands for the clothes, must not differ from clip to
clip, and a clip that shows the person from one side alone could not find it. So a long video is
refined in two rounds:

1. *Skim*: some short runs of frames, spread over the whole video, are refined together, as a short
   video would be. Only what all frames share is kept of the result. The frames come in runs because
   the energies between neighbours in time need neighbours.
2. *Clips*: what is shared stays as the first round found it. Every clip then depends on its own
   frames alone, and clips can be refined at the same time on any number of machines, with the same
   result.

Neighbouring clips overlap. At its ends a clip lacks the neighbours in time that would correct it,
so both solutions are blended where two clips overlap, the weight of each falling linearly toward
its own end:

    R_k = R_k^a exp(w_k log(R_k^a⁻¹ R_k^b)),    t_k = (1 - w_k) t_k^a + w_k t_k^b,
    w_k = (k - start_b + 1) / (overlap + 1)

The cut depends on the video's length alone, not on the number of workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import roma
import torch
from torch import Tensor

from gva_mi.body.pose import Pose

RUNS = 8  # of the skim: a person who turns once is seen from eight sides

Value = TypeVar("Value")


def cut(frames: int, longest: int, overlap: int) -> list[range]:
    """Clips of nearly equal length, at most ``longest``, each sharing ``overlap`` with the next."""
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


def of_clip(clip: range, by_frame: Mapping[int, Value]) -> dict[int, Value]:
    """The values of a clip's frames, where there are any, counted from the clip's first frame."""
    return {k - clip.start: by_frame[k] for k in clip if k in by_frame}


def poses_of_clip(clip: range, pose: Pose) -> Pose:
    """The poses of a clip's frames."""
    return pose[slice(clip.start, clip.stop)]


def join(clips: Sequence[range], poses: Sequence[Pose]) -> Pose:
    """The poses of all frames from those of the clips.

    Args:
        clips: as :func:`cut` gives them.
        poses: of each clip.
    """
    first, *_ = poses
    R, t, psi = first.rotations, first.transl, first.expression
    for clip, other in zip(clips[1:], poses[1:], strict=True):
        shared = len(R) - clip.start
        weight = (torch.arange(shared, dtype=t.dtype) + 1)[:, None] / (shared + 1)
        rotations, transl = other.rotations, other.transl
        between = _slerp(R[clip.start :], rotations[:shared], weight[..., None])
        R = torch.cat([R[: clip.start], between, rotations[shared:]])
        between = torch.lerp(t[clip.start :], transl[:shared], weight)
        t = torch.cat([t[: clip.start], between, transl[shared:]])
        between = torch.lerp(psi[clip.start :], other.expression[:shared], weight)
        psi = torch.cat([psi[: clip.start], between, other.expression[shared:]])
    return Pose(R, t, psi)


def _slerp(a: Tensor, b: Tensor, weight: Tensor) -> Tensor:
    """The rotation (..., 3) on the way from ``a`` to ``b``, axis-angle."""
    way = roma.rotvec_composition([roma.rotvec_inverse(a), b])
    return roma.rotvec_composition([a, weight * way])
