"""Eq. 8 as printed: each frame on its own, the bare body, rotations only.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

Eq. 8 prints no norm for the regulariser, which could then fall without bound; it is taken squared.
Its weights fall with the depth in the kinematic tree, ``ω_i = 1 / (1 + depth_i)``: the farther out
a joint, the less accurate is its stage-1 rotation. The translation stays at stage 1, because Eq. 8
optimises ``θ`` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.console import Progress, within
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.descent import with_frames
from gva_mi.pose.job import RefineJob, RefineOptions, Solution
from gva_mi.pose.vector_adam import VectorAdam, lever_arms, turn_rates
from gva_mi.ranges import Metres, Turn, Weight, Within

Steps = Annotated[int, Within(1, 100_000)]

DECAY = 0.1  # final learning rates, relative to the initial ones
FRAMES_A_JOB = 16  # each is refined on its own, but a job for each would be too small


@dataclass(frozen=True)
class SingleFrameOptions(RefineOptions):
    """Options of the refinement frame by frame."""

    steps: Steps = 80  # for each frame
    prior: Weight = 0.5  # λ2, for one square radian
    # Metres that a turned joint moves what hangs on it, in a step at the start.
    step: Metres = 0.012
    largest_turn: Turn = 0.03  # radians in such a step; it limits joints with short lever arms

    name: ClassVar[str] = "paper"

    @property
    def description(self) -> str:
        return "Eq. 8 as printed"

    def variants(self) -> dict[str, RefineOptions]:
        return {"no prior": replace(self, prior=0.0)}


def refine_single_frames(
    job: RefineJob, options: SingleFrameOptions, progress: Progress | None = None
) -> Solution:
    """Minimise Eq. 8 in every frame that has evidence; the others keep their pose."""
    scene, pose = job.scene(), job.pose
    rest = job.body.rest(job.shape)
    arms = lever_arms(rest, job.body.weights, job.body.parents)
    rates = turn_rates(arms, options.step, options.largest_turn)
    total = options.steps * len(job.evidence)
    for number, k in enumerate(sorted(job.evidence)):
        of_frame = within(progress, number * options.steps, options.steps, total)
        pose = with_frames(pose, [k], _refine_frame(job, k, options, scene, rates, of_frame))
    return Solution(pose, job.shape, torch.zeros_like(job.body.v_template))


def _refine_frame(
    job: RefineJob,
    k: int,
    options: SingleFrameOptions,
    scene: MeshScene,
    rates: Tensor,
    progress: Progress | None,
) -> Pose:
    stage1, evidence = job.pose[k], job.evidence[k]
    weights = joint_weights(job.body.parents)[:, None]
    theta = stage1.rotations.clone().requires_grad_()
    adam = VectorAdam([theta], [rates])
    for step in range(options.steps):
        pose = Pose(theta, stage1.transl, stage1.expression)
        image = scene.render(job.body(pose, job.shape).vertices[0], evidence.camera)
        turned = (weights * (theta - stage1.rotations).square()).sum()
        loss = evidence.loss(image, options.silhouette) + options.prior * turned
        loss.backward()
        adam.step(DECAY ** (step / options.steps))
        if progress is not None:
            progress(step + 1, options.steps, loss=float(loss.detach()))
    return Pose(theta.detach(), stage1.transl, stage1.expression)


def joint_weights(parents: Sequence[int]) -> Tensor:
    """``ω`` (J,): 1 for the root, 1/2 for its children, and so on."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return 1 / (1 + torch.tensor(depth, dtype=torch.float32))
