"""Eq. 9 as printed: each frame for itself, the bare body, rotations only.

The norm that the regulariser lacks is taken squared (:mod:`gva_mi.pose.priors`). The translation
stays as stage 1 gave it, for Eq. 9 speaks of ``θ`` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.evidence import Target
from gva_mi.pose.priors import FACE, joint_weights, levers
from gva_mi.pose.sequence import Solution
from gva_mi.pose.vector_adam import VectorAdam

DECAY = 0.1  # what is left of the learning rates at the end

if TYPE_CHECKING:
    from gva_mi.pose.refine import RefineOptions


def refine_single_frames(
    targets: dict[int, Target],
    scene: MeshScene,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    options: RefineOptions,
    progress: Callable[..., None] | None = None,
) -> Solution:
    """Minimise Eq. 9 in every frame that has a target; arguments as in ``refine_sequence``."""
    weights = joint_weights(body.parents)[:, None]
    far = levers(body.rest(shape), body.weights, body.parents)
    reach = (options.step / far).clamp_max(options.largest_turn)[:, None]
    rotations = pose.rotations.clone()
    total = options.steps * len(targets)
    for number, (k, target) in enumerate(sorted(targets.items())):
        stage1 = pose.rotations[k]
        theta = stage1.clone().requires_grad_()
        adam = VectorAdam([theta], [reach])
        for step in range(options.steps):
            one = Pose(theta[None], pose.transl[k : k + 1], pose.expression[k : k + 1])
            image = scene.render(body(one, shape).vertices[0], target.camera)
            loss = target.normal_loss(image) + options.silhouette * target.silhouette_loss(image)
            loss = loss + options.paper_prior * (weights * (theta - stage1).square()).sum()
            loss.backward()
            theta.grad[FACE] = 0
            adam.step(DECAY ** (step / options.steps))
            if progress is not None:
                progress(number * options.steps + step + 1, total, loss=float(loss.detach()))
        rotations[k] = theta.detach()
    bare = torch.zeros_like(body.v_template)
    return Solution(rotations, pose.transl.clone(), bare, shape.betas)
