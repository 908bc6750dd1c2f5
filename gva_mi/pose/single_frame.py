"""Eq. 8 as printed: each frame for itself, the bare body, rotations only.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

The norm that the regulariser lacks is taken squared (:mod:`gva_mi.pose.priors`). The translation
stays as stage 1 gave it, because Eq. 8 speaks of ``θ`` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.console import Progress, within
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.clips import cut
from gva_mi.pose.descent import with_frames
from gva_mi.pose.job import Job, RefineOptions, Solution
from gva_mi.pose.priors import joint_weights, lever_arms, turn_rates
from gva_mi.pose.vector_adam import VectorAdam
from gva_mi.ranges import Metres, Turn, Weight, Within

Steps = Annotated[int, Within(1, 100_000)]

DECAY = 0.1  # what is left of the learning rates at the end
FRAMES_A_JOB = 16  # each is refined for itself, but a job for each would be too small


@dataclass(frozen=True)
class SingleFrameOptions(RefineOptions):
    """How every frame is refined for itself."""

    steps: Steps = 80  # for each frame
    prior: Weight = 0.5  # λ2, for one square radian
    # Metres that a turned joint moves what hangs on it, in a step at the start.
    step: Metres = 0.012
    largest_turn: Turn = 0.03  # radians in such a step; it limits joints with short lever arms

    name: ClassVar[str] = "paper"

    @property
    def description(self) -> str:
        return "Eq. 8 as printed"

    def clips(self, frames: int) -> list[range]:
        return cut(frames, FRAMES_A_JOB, 0)

    def steps_for(self, frames: int) -> int:
        return frames * self.steps

    def solve(self, job: Job, progress: Progress | None = None) -> Solution:
        return refine_single_frames(job, self, progress)

    def variants(self) -> dict[str, RefineOptions]:
        return {"no prior": replace(self, prior=0.0)}


def refine_single_frames(
    job: Job, options: SingleFrameOptions, progress: Progress | None = None
) -> Solution:
    """Minimise Eq. 8 in every frame that has evidence; the others keep their pose.

    Args:
        job: what is known.
        options: of the refinement.
        progress: called as ``progress(done, total, loss=...)`` after every step.
    """
    scene, pose = job.scene(), job.pose
    rest = job.body.rest(job.shape)
    arms = lever_arms(rest, job.body.weights, job.body.parents)
    rates = turn_rates(arms, options.step, options.largest_turn)
    for number, k in enumerate(sorted(job.evidence)):
        told = within(progress, number * options.steps, options.steps, job.steps)
        pose = with_frames(pose, [k], _refine_frame(job, k, options, scene, rates, told))
    return Solution(pose, job.shape, torch.zeros_like(job.body.v_template))


def _refine_frame(
    job: Job,
    k: int,
    options: SingleFrameOptions,
    scene: MeshScene,
    rates: Tensor,
    progress: Progress | None,
) -> Pose:
    """The pose of one frame."""
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
