"""Eq. 8 as printed: each frame on its own, the bare body, rotations only.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

Eq. 8 prints no norm for the regulariser, which could then fall without bound; it is taken squared.
Its weights fall with the depth in the kinematic tree, ``ω_i = 1 / (1 + depth_i)``: the farther out
a joint, the less accurate is its stage-1 rotation. The translation stays at stage 1, because Eq. 8
optimises ``θ`` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.core.console import Progress
from gva_mi.core.options import Metres, Turn, Weight, Within
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.job import RefineJob, RefineOptions, Solution
from gva_mi.pose.optimizer import VectorAdam, lever_arms, turn_rates

Steps = Annotated[int, Within(1, 100_000)]

DECAY = 0.1  # final learning rates, relative to the initial ones
FRAMES_A_JOB = 16  # each is refined on its own, but a job for each would be too small


@dataclass(frozen=True)
class SingleFrameOptions(RefineOptions):
    """Options of the refinement frame by frame."""

    steps: Steps = 80  # steps for each frame
    prior: Weight = 0.5  # λ2, for one square radian
    # Metres that a joint moves the skin beyond it, in a first step.
    step: Metres = 0.012
    largest_turn: Turn = 0.03  # radians in such a step; limits joints with short lever arms

    name: ClassVar[str] = "paper"


def refine_single_frames(
    job: RefineJob, options: SingleFrameOptions, progress: Progress | None = None
) -> Solution:
    """Minimise Eq. 8 in every frame that has evidence; the others keep their pose."""
    body, pose, total = job.body, job.pose, options.steps * len(job.evidence)
    scene, rest = MeshScene(body.faces, body.v_template), body.rest(job.shape)
    arms = lever_arms(rest, body.weights, body.parents)
    rates = turn_rates(arms, options.step, options.largest_turn)
    weights = joint_weights(body.parents)[:, None]
    for number, k in enumerate(sorted(job.evidence)):
        stage1, evidence = job.pose[k], job.evidence[k]
        theta = stage1.rotations.clone().requires_grad_()
        adam = VectorAdam([theta], [rates])
        for step in range(options.steps):
            turned = Pose(theta, stage1.transl, stage1.expression)
            vertices, normals = body(turned, job.shape).vertices[0], evidence.normals is not None
            image = scene.render(vertices, evidence.camera, normals)
            loss = evidence.loss(image, options.silhouette)
            square = (weights * (theta - stage1.rotations).square()).sum()
            loss = loss + options.prior * square
            loss.backward()
            adam.step(DECAY ** (step / options.steps))
            if progress is not None:
                progress(number * options.steps + step + 1, total, loss=float(loss.detach()))
        found = Pose(theta.detach(), stage1.transl, stage1.expression)
        pose = pose.with_frames([k], found)
    return Solution(pose, job.shape, torch.zeros_like(body.v_template))


def joint_weights(parents: Sequence[int]) -> Tensor:
    """``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))
