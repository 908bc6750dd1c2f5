"""Stage 2 of the paper (Eq. 9): poses made to agree with normals and silhouettes.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

with the normals ``N`` and the silhouette ``S`` of the posed body, rendered by
:mod:`gva_mi.pose.scene`.

Two ways:

* ``loss="sequence"`` (default, :mod:`gva_mi.pose.sequence`): all frames together, with one
  displacement of the rest surface for the clothes, neighbours in time, and a translation that is
  free but held. The paper's Eq. 9 fits a bare body to the mask of a clothed one, and on such a
  person it makes poses worse than stage 1.
* ``loss="paper"`` (:mod:`gva_mi.pose.single_frame`): Eq. 9 as printed, frame by frame, the bare
  body, rotations only.

Frames of all splits are refined alike, from their own masks and normals. Frames without normals are
fitted to their silhouettes alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.pose.scene import BodyScene
from gva_mi.pose.sequence import Solution, refine_sequence
from gva_mi.pose.single_frame import refine_single_frames
from gva_mi.pose.target import CannotRefine, Target
from gva_mi.threads import one_torch_thread

Progress = Callable[..., None]


@dataclass(frozen=True)
class RefineOptions:
    """How poses are refined. Losses are divided by the person's area: see gva_mi.pose.target."""

    loss: Literal["sequence", "paper"] = "sequence"  # all frames together, or Eq. 9 frame by frame
    size: int = 256  # pixels of the longer side of the pictures that are compared
    passes: int = 40  # sequence: how often every frame is visited
    steps: int = 80  # paper: steps for each frame
    silhouette: float = 5.0  # λ1
    prior: float = 0.5  # λ2, for one square radian
    smooth: float = 2.0  # sequence: pull to both neighbours' rotations, for one square radian
    smooth_move: float = 200.0  # sequence: pull to both neighbours' places, for one square metre
    hold: float = 0.5  # sequence: pull of the translation to stage 1, for one square metre
    cloth_smooth: float = 4000.0  # sequence: a of the displacement's energy, for one square metre
    cloth_small: float = 40.0  # sequence: b
    cloth_outward: float = 400.0  # sequence: c
    step: float = 0.016  # metres that a turned joint moves what hangs on it, in a step at the start
    largest_turn: float = 0.04  # radians in such a step; joints with short levers are held by it
    translation_lr: float = 0.008  # metres in a step at the start; depth is seen weakly
    cloth_lr: float = 0.002  # metres in a step at the start
    seed: int = 0  # of the order in which frames are visited

    def __post_init__(self) -> None:
        if self.loss not in ("sequence", "paper"):
            raise InputError(f"refine: loss must be 'sequence' or 'paper', got {self.loss!r}")
        for name in ("size", "passes", "steps"):
            if getattr(self, name) < 1:
                raise InputError(f"refine: {name} must be at least 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class Refined:
    """Poses after stage 2, and what is known of how they came about."""

    pose: Pose  # all frames
    shape: Shape
    offsets: Tensor  # (V, 3) the displacement shared by all frames, metres; zero for loss="paper"
    losses_stage1: (
        Tensor  # (T,) L_normal + λ1 L_silhouette at stage 1; NaN where there is no target
    )
    losses: Tensor  # (T,) the same at the refined pose
    kept: dict[int, str]  # frames that keep their stage-1 pose, and why
    without_normals: list[int]  # frames that were fitted to their silhouette alone
    seconds_per_frame: float


def refine(
    video: Video, body: BodyModel, options: RefineOptions, progress: Progress | None = None
) -> Refined:
    """Refine the poses of all frames of a video.

    Args:
        video: frames, cameras, masks, perhaps normals, and stage-1 poses.
        body: the body that the poses move.
        options: how.
        progress: called as ``progress(done, total, loss=...)`` after every step.

    Returns:
        Poses of all frames. A frame that cannot be refined keeps its stage-1 pose and is listed in
        ``kept``: an empty mask, a body out of view, or a loss that did not fall below stage 1's.
    """
    begin = time.perf_counter()
    with one_torch_thread():
        targets, kept = _targets(video, body, options.size)
        pose, shape = video.pose.to(torch.float32), Shape(video.shape.betas.to(torch.float32))
        solution = Solution(pose.rotations, pose.transl, torch.zeros_like(body.v_template))
        losses_stage1 = losses = torch.full((len(video),), torch.nan)
        if targets:
            scene = BodyScene(body.faces, body.v_template)
            route = refine_sequence if options.loss == "sequence" else refine_single_frames
            solution = route(targets, scene, body, pose, shape, options, progress)
            before = Solution(pose.rotations, pose.transl, solution.offsets)
            losses_stage1 = _losses(targets, scene, body, pose, shape, before, options)
            losses = _losses(targets, scene, body, pose, shape, solution, options)
    for k in targets:
        if not losses[k] <= losses_stage1[k]:  # NaN counts as worse
            kept[k] = f"its loss grew from {losses_stage1[k]:.3f} to {losses[k]:.3f}"
    rotations, transl = solution.rotations.clone(), solution.transl.clone()
    for k in kept:
        rotations[k], transl[k] = pose.rotations[k], pose.transl[k]
    return Refined(
        Pose.from_rotations(rotations, transl, pose.expression),
        shape,
        solution.offsets,
        losses_stage1,
        losses,
        dict(sorted(kept.items())),
        [k for k, target in targets.items() if target.normals is None],
        (time.perf_counter() - begin) / len(video),
    )


def _targets(video: Video, body: BodyModel, size: int) -> tuple[dict[int, Target], dict[int, str]]:
    """What each frame says, and the frames that say nothing."""
    targets, kept = {}, {}
    for frame in video.frames():
        with torch.no_grad():
            vertices = body(frame.pose, video.shape).vertices[0]
        try:
            targets[frame.index] = Target.of(frame, size, vertices)
        except CannotRefine as reason:
            kept[frame.index] = str(reason)
    return targets, kept


@torch.no_grad()
def _losses(
    targets: dict[int, Target],
    scene: BodyScene,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    solution: Solution,
    options: RefineOptions,
) -> Tensor:
    """L_normal + λ1 L_silhouette of each frame (T,); NaN where there is no target."""
    losses = torch.full((len(pose),), torch.nan)
    for k, target in targets.items():
        one = Pose.from_rotations(
            solution.rotations[k : k + 1], solution.transl[k : k + 1], pose.expression[k : k + 1]
        )
        image = scene.render(body(one, shape, solution.offsets).vertices[0], target.camera)
        losses[k] = target.normal_loss(image) + options.silhouette * target.silhouette_loss(image)
    return losses
