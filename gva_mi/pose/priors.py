"""How much joints are held, and how far they reach.

Eq. 9's regulariser ``Σ ω_i (θ_i - θ_i^stage1)`` has no norm as printed and could fall without
bound; it is taken squared. Its weights fall with the distance from the root in the kinematic tree,
``ω_i = 1 / (1 + depth_i)``: the farther out a joint, the worse stage 1 knows it, and the less it is
held. That is for the frame by frame way. The whole sequence's energies count metres: what a turn
moves, by the lever of its joint. Estimators err so, by about as much all over the body, and so do
pictures tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND
from gva_mi.body.smplx import Rest

FACE = slice(JOINTS.index("jaw"), JOINTS.index("right_eye_smplhf") + 1)  # neither seen nor moved
LEAST, FINGERS = 0.2, 0.35  # metres, of levers that hold


def joint_weights(parents: Sequence[int]) -> Tensor:
    """``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))


def levers(rest: Rest, weights: Tensor, parents: Sequence[int]) -> Tensor:
    """How far (J,) metres, on average, what a joint turns is away from it.

    The mean is quadratic, over the vertices below the joint in the kinematic tree.

    Args:
        rest: the person's vertices (V, 3) and joints (J, 3) in the rest pose.
        weights: (V, J) skinning weights.
        parents: of the joints, -1 for the root.
    """
    moved = weights.clone()
    for joint in reversed(range(1, len(parents))):
        moved[:, parents[joint]] += moved[:, joint]
    square = (rest.vertices[:, None] - rest.joints).square().sum(-1)
    return ((moved * square).sum(0) / moved.sum(0).clamp_min(1e-6)).sqrt()


def held_levers(far: Tensor) -> Tensor:
    """The levers (J,) metres by which joints are held to stage 1 and to their neighbours in time.

    Short ones count as ``LEAST``: a turned foot or head moves little, but is not free to turn.
    Those of the fingers count as ``FINGERS``: a few pixels do not tell 15 joints from each other.

    Args:
        far: (J,) from :func:`levers`.
    """
    held = far.clamp_min(LEAST)
    for hand in (LEFT_HAND, RIGHT_HAND):
        held[hand] = held[hand].clamp_min(FINGERS)
    return held
