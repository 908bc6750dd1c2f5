"""How much a turn of a joint moves, and how strongly it is held to stage 1.

The lever arm of a joint is its mean distance from the surface that turns with it, in metres. Both
ways of refining divide their steps by it, so that a step moves the surface by about as much
whichever joint it turns.

They hold a pose to stage 1 differently. Eq. 8's regulariser ``Σ ω_i (θ_i - θ_i^stage1)`` has no
norm as printed, and could fall without bound; the way frame by frame squares it. Its weights
fall with the distance from the root in the kinematic tree, ``ω_i = 1 / (1 + depth_i)``: the farther
out a joint, the worse stage 1 knows it, and the less it is held. A whole sequence assumes no such
order: how well stage 1 knows a joint is inferred (:mod:`gva_mi.pose.inference`).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.body.pose import JAW_AND_EYES
from gva_mi.body.smplx import Rest

# Jaw and eyes are never turned: neither masks nor normals of this size show them.
FACE = JAW_AND_EYES


def joint_weights(parents: Sequence[int]) -> Tensor:
    """``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))


def lever_arms(rest: Rest, weights: Tensor, parents: Sequence[int]) -> Tensor:
    """Mean distance (J,) metres between a joint and what turns with it.

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


def turn_rates(arms: Tensor, step: float, largest_turn: float) -> Tensor:
    """Learning rates (J, 1) of the joints' turns, radians; zero for the face.

    Args:
        arms: (J,) lever arms, metres.
        step: metres that a step moves what turns with the joint.
        largest_turn: radians; no joint turns more in a step, however short its lever arm.
    """
    rates = (step / arms).clamp_max(largest_turn)[:, None]
    rates[FACE] = 0
    return rates
