"""Eq. 8 as printed: each frame on its own, the bare body, rotations only.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

Eq. 8 prints no norm for the regulariser, which could then fall without bound; here it is squared.
Its weights fall with the depth in the kinematic tree, ``ω_i = 1 / (1 + depth_i)``, because the
stage-1 rotations of outer joints are less accurate. The translation stays at stage 1, because Eq. 8
optimises ``θ`` alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import Metres, Turn, Weight, Within, options_of
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.refine.optimize import Faces, PersonSize
from gva_mi.refine.vector_adam import VectorAdam, lever_arms, turn_rates

DECAY = 0.1  # final learning rates, relative to the initial ones; chosen: poses settle
FRAMES_A_JOB = 16  # frames are independent; chosen so that jobs are not too small


@options_of("refine")
class SingleFrameOptions:
    """Options of the refinement frame by frame."""

    passes: Annotated[int, Within(1, 100_000)] = 80  # steps for each frame
    size: PersonSize = 208
    faces: Faces = 3500
    silhouette: Weight = 1.0  # λ1
    prior: Weight = 0.5  # λ2, for one square radian
    step: Metres = 0.012  # metres that a joint moves the skin beyond it, in a first step
    largest_turn: Turn = 0.03  # radians in such a step; limits joints with short lever arms

    name: ClassVar[str] = "paper"


def refine_single_frames(
    evidence: Mapping[int, MaskAndNormals],
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    options: SingleFrameOptions,
    progress: Progress | None = None,
) -> Pose:
    """Minimise Eq. 8 in every frame that has evidence; other frames keep their pose."""
    total = options.passes * len(evidence)
    scene, rest = MeshScene(body.faces, body.v_template), body.rest(shape)
    arms = lever_arms(rest, body.weights, body.parents)
    rates = turn_rates(arms, options.step, options.largest_turn)
    weights = joint_weights(body.parents)[:, None]
    for number, k in enumerate(sorted(evidence)):
        stage1, seen = pose[k], evidence[k]
        theta = stage1.rotations.clone().requires_grad_()
        adam = VectorAdam([theta], [rates])
        for step in range(options.passes):
            turned = Pose(theta, stage1.transl, stage1.expression)
            vertices = body(turned, shape).vertices[0]
            image = scene.render(vertices, seen.camera, seen.normals is not None)
            off = (weights * (theta - stage1.rotations).square()).sum()
            loss = seen.loss(image, options.silhouette) + options.prior * off
            loss.backward()
            adam.step(DECAY ** (step / options.passes))
            if progress is not None:
                progress(number * options.passes + step + 1, total, loss=float(loss.detach()))
        pose = pose.with_frames([k], Pose(theta.detach(), stage1.transl, stage1.expression))
    return pose


def joint_weights(parents: Sequence[int]) -> Tensor:
    """Return ``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))
