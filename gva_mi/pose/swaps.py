"""Fix frames in which stage 1 swapped left and right legs, or arms.

A single-frame estimator now and then gives the left leg the pose of the right one, and vice versa.
Gradient descent hardly recovers: the wrong leg fills the outline as well by tilting the other way
in depth. So swaps are searched for before any optimisation. In each frame two limbs are as given,
``s_k = 0``, or exchanged, ``s_k = 1``: each has the rotations of the other, mirrored in the plane
that halves the body at rest. The states minimise

1. ``E(s) = w Σ_k (L_k(s_k) / ν + cost(Δ_k(s_k, s_k+1))) + Σ_k (a s_k + b [s_k-1 < s_k])``

with ``L_k`` the data term of Eq. 8 at this pose of stage 1, and the cost of how the limbs' joints
turn from frame to frame (:mod:`gva_mi.pose.prior.motion`, eq. 2), at the speed that stage 1 shows.
The chain of two states a frame is minimised by dynamic programming (Viterbi).

``w`` is below 1 because joints of a limb turn together, and so do the pixels on it. With legs
apart, images and motion decide by tens of nats. ``a`` and ``b`` decide where they do not: for limbs
in equal poses, and for a video in which all frames would be exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose
from gva_mi.pose.prior.inference import JOINTS as CORRECTED
from gva_mi.pose.prior.inference import prior_from_stage1
from gva_mi.pose.prior.motion import cost
from gva_mi.pose.stage1 import Stage1, turns_between

EACH, BEGINS = 1.0, 4.6  # a and b, nats: one frame in a hundred begins a run of exchanged ones
TOGETHER = 0.25  # w
LIMBS: Mapping[str, Sequence[str]] = MappingProxyType(  # the joints whose motion is compared
    {
        "legs": ("hip", "knee", "ankle", "foot"),
        "arms": ("collar", "shoulder", "elbow", "wrist"),
    }
)
_MIRRORED = torch.tensor([1.0, -1.0, -1.0])  # mirrors an axis-angle in the plane x = 0


def fix_swaps(
    stage1: Stage1, losses: Callable[[Pose], Tensor], prior_weight: float
) -> tuple[Pose, dict[str, list[int]]]:
    """Return stage-1 poses with swapped limbs exchanged (eq. 1), and where, for each pair of limbs.

    ``losses`` returns the data term of Eq. 8 (n,) in poses of the n frames, NaN without evidence;
    ``prior_weight`` is ν, the weight of the prior beside it.
    """
    pose, found = stage1.pose, dict[str, list[int]]()
    if len(pose) < 2:
        return pose, {}
    as_given = losses(pose)
    for name in LIMBS:
        other = exchanged(pose, name)
        after = losses(other)
        data = torch.stack([as_given, after], 1).nan_to_num(0.0) / prior_weight
        motion = _motion(stage1, name, (pose, other))
        swapped = least_states(TOGETHER * data, TOGETHER * motion)
        if swapped.any():
            found[name] = swapped.nonzero()[:, 0].tolist()
            as_given = torch.where(swapped, after, as_given)
            rotations = torch.where(swapped[:, None, None], other.rotations, pose.rotations)
            pose = replace(pose, rotations=rotations)
    return pose, found


def exchanged(pose: Pose, name: str) -> Pose:
    """Return poses whose two limbs of that name have changed sides, in every frame."""
    left, right = _limbs(name)
    if name == "arms":  # together with their hands
        left = left + list(range(LEFT_HAND.start, LEFT_HAND.stop))
        right = right + list(range(RIGHT_HAND.start, RIGHT_HAND.stop))
    rotations = pose.rotations.clone()
    rotations[:, left + right] = pose.rotations[:, right + left] * _MIRRORED
    return replace(pose, rotations=rotations)


def least_states(data: Tensor, motion: Tensor, each: float = EACH) -> Tensor:
    """Return which frames are exchanged (n,): the states of least energy, eq. 1.

    ``data`` (n, 2) is the energy of each frame in each state, ``motion`` (n - 1, 2, 2) that of each
    step from one state to another, nats; ``each`` is ``a``.
    """
    own = data + torch.tensor([0.0, each])
    begins = torch.tensor([[0.0, BEGINS], [0.0, 0.0]])
    least, before = own[0] + begins[0], []
    for k, step in enumerate(motion + begins, start=1):
        total, best = (least[:, None] + step).min(0)
        least = total + own[k]
        before.append(best)
    states = [int(least.argmin())]
    for best in reversed(before):
        states.append(int(best[states[-1]]))
    return torch.tensor(states[::-1]) == 1


def _motion(stage1: Stage1, name: str, poses: Sequence[Pose]) -> Tensor:
    """Return the motion's cost (n - 1, 2, 2), from one of two poses to one of two poses."""
    left, right = _limbs(name)
    joints, process = left + right, prior_from_stage1(stage1).joints
    # A step contains the white errors of both frames.
    white = torch.tensor([noise.white for noise in process.error_models]).square()
    square = (process.square_speed + 2 * white)[:, [CORRECTED.index(i) for i in joints]]
    rotations = [pose.rotations[:, joints] for pose in poses]
    steps = [[turns_between(a[:-1], b[1:]) for b in rotations] for a in rotations]
    return torch.stack(
        [torch.stack([cost(step, square).sum(1) for step in row], -1) for row in steps], -2
    )


def _limbs(name: str) -> tuple[list[int], list[int]]:
    """Return the joints of the left limb, and those of the right one."""
    sides = ([JOINTS.index(f"{side}_{x}") for x in LIMBS[name]] for side in ("left", "right"))
    left, right = sides
    return left, right
