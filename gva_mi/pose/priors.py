"""How much joints are held, and how far they reach.

Eq. 9's regulariser ``Σ ω_i (θ_i - θ_i^stage1)`` has no norm as printed and could fall without
bound; it is taken squared. Its weights fall with the distance from the root in the kinematic tree,
``ω_i = 1 / (1 + depth_i)``: the farther out a joint, the worse stage 1 knows it, and the less it is
held.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel


def joint_weights(parents: Sequence[int]) -> Tensor:
    """``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))


def levers(body: BodyModel, shape: Shape) -> Tensor:
    """How far (J,) metres, on average, what a joint turns is away from it.

    The mean is quadratic, over the vertices below the joint in the kinematic tree.
    """
    rest = body.rest(shape)
    moved = body.weights.clone()
    for joint in reversed(range(1, len(body.parents))):
        moved[:, body.parents[joint]] += moved[:, joint]
    square = (rest.vertices[:, None] - rest.joints).square().sum(-1)
    return ((moved * square).sum(0) / moved.sum(0).clamp_min(1e-6)).sqrt()
