"""Legs, or arms, that stage 1 takes for each other in some frames.

An estimator that sees each frame for itself now and then gives the left leg the pose of the right
one, and the right one that of the left. A descent hardly finds out of it: the leg that steps ahead
fills the outline of the one behind as well as that one did, by leaning the other way in depth. So
it is looked for before any descent. In each frame the two limbs are as given, ``s_k = 0``, or
exchanged, ``s_k = 1``: each has the rotations of the other, mirrored in the plane that halves the
body at rest. The likeliest are those of the least

1. ``E(s) = w Σ_k (L_k(s_k) / nat + cost(Δ_k(s_k, s_k+1))) + Σ_k (a s_k + b [s_k-1 < s_k])``

with ``L_k`` the data term of Eq. 8 at this pose of stage 1, and the cost of how the limbs' joints
turn from frame to frame (:mod:`gva_mi.pose.motion`, eq. 2), as fast as stage 1 shows them to be.
Two states a frame are a chain, whose least energy dynamic programming finds (Viterbi).

Joints of a limb turn together, and pixels on it are wrong together: ``w`` counts several as one.
Where legs are astride, pictures and motion tell by tens of nats. ``a`` and ``b`` decide where they
do not: about limbs that are held alike, which jitter would exchange and nothing would be won, and
about a video in which all would be exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose
from gva_mi.pose.inference import JOINTS as CORRECTED
from gva_mi.pose.inference import from_stage1
from gva_mi.pose.motion import cost
from gva_mi.pose.stage1 import Stage1, turns_between

SIDES = ("left", "right")
EACH, BEGINS = 1.0, 4.6  # a and b, nats: one frame in a hundred begins a run of exchanged ones
TOGETHER = 0.25  # w
LIMBS: Mapping[str, Sequence[str]] = MappingProxyType(  # the joints of which motion is asked
    {
        "legs": ("hip", "knee", "ankle", "foot"),
        "arms": ("collar", "shoulder", "elbow", "wrist"),
    }
)
_MIRRORED = torch.tensor([1.0, -1.0, -1.0])  # of an axis-angle, in the plane x = 0


def put_right(
    stage1: Stage1, losses: Callable[[Pose], Tensor], nat: float
) -> tuple[Pose, dict[str, list[int]]]:
    """Poses of stage 1 with left and right limbs exchanged where that is likelier (eq. 1).

    Args:
        stage1: n frames of a video, in order.
        losses: gives the data term of Eq. 8 (n,) at poses of these frames; NaN where nothing tells.
        nat: what a nat counts beside the data term.

    Returns:
        The poses, and for each pair of limbs the places among the n where it was exchanged.
    """
    pose, found = stage1.pose, dict[str, list[int]]()
    if len(pose) < 2:
        return pose, {}
    as_given = losses(pose)
    for name in LIMBS:
        other = exchanged(pose, name)
        after = losses(other)
        data = torch.stack([as_given, after], 1).nan_to_num(0.0) / nat
        motion = _motion(stage1, name, (pose, other))
        swapped = likeliest(TOGETHER * data, TOGETHER * motion)
        if swapped.any():
            found[name] = swapped.nonzero()[:, 0].tolist()
            as_given = torch.where(swapped, after, as_given)
            rotations = torch.where(swapped[:, None, None], other.rotations, pose.rotations)
            pose = replace(pose, rotations=rotations)
    return pose, found


def exchanged(pose: Pose, name: str) -> Pose:
    """Poses whose two limbs of that name have changed sides, in every frame."""
    left, right = _limbs(name)
    if name == "arms":  # with which their hands go
        left, right = left + _joints(LEFT_HAND), right + _joints(RIGHT_HAND)
    rotations = pose.rotations.clone()
    rotations[:, left + right] = pose.rotations[:, right + left] * _MIRRORED
    return replace(pose, rotations=rotations)


def likeliest(data: Tensor, motion: Tensor) -> Tensor:
    """Which frames are exchanged (n,): the states ``s`` of the least energy, eq. 1.

    Args:
        data: (n, 2) of each frame in each state, nats.
        motion: (n - 1, 2, 2) of each step, from one state to another, nats.
    """
    own = data + torch.tensor([0.0, EACH])
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
    """What steps cost (n - 1, 2, 2), from one of two poses to one of two poses."""
    left, right = _limbs(name)
    joints, belief = left + right, from_stage1(stage1).joints
    # In a step there are the white errors of both frames.
    white = torch.tensor([noise.white for noise in belief.noises]).square()
    square = (belief.square_speed + 2 * white)[:, [CORRECTED.index(i) for i in joints]]
    rotations = [pose.rotations[:, joints] for pose in poses]
    steps = [[turns_between(a[:-1], b[1:]) for b in rotations] for a in rotations]
    return torch.stack(
        [torch.stack([cost(step, square).sum(1) for step in row], -1) for row in steps], -2
    )


def _limbs(name: str) -> tuple[list[int], list[int]]:
    """The joints of the left limb, and those of the right one."""
    left, right = ([JOINTS.index(f"{side}_{joint}") for joint in LIMBS[name]] for side in SIDES)
    return left, right


def _joints(hand: slice) -> list[int]:
    return list(range(hand.start, hand.stop))
