"""Stage 2 of the paper (Eq. 9): poses made to agree with normals and silhouettes.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

with the normals ``N`` and the silhouette ``S`` of the posed body, rendered by
:mod:`gva_mi.mesh.mesh_scene`.

Two ways:

* ``loss="sequence"`` (default, :mod:`gva_mi.pose.sequence`): all frames together, with corrections
  of stage 1 that are slow in time (:mod:`gva_mi.pose.corrections`), one displacement of the rest
  surface for the clothes, and the person's shape. The paper's Eq. 9 fits a bare body to the mask of
  a clothed one, and on such a person it makes poses worse than stage 1.
* ``loss="paper"`` (:mod:`gva_mi.pose.single_frame`): Eq. 9 as printed, frame by frame, the bare
  body, rotations only.

Frames of all splits are refined alike, from their own masks and normals. Frames without normals are
fitted to their silhouettes alone.

Single frames, parts of long videos (:mod:`gva_mi.pose.clips`) and the videos of several subjects
are independent of each other, and may be refined at the same time (:mod:`gva_mi.pose.parallel`).
How the work is cut does not depend on who does it, so that any number of workers finds the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.errors import InputError
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.clips import cut, join, skim
from gva_mi.pose.coarse_body import CoarseBody
from gva_mi.pose.evidence import CannotRefine, Target
from gva_mi.pose.parallel import Job, Solved, run
from gva_mi.pose.sequence import Solution
from gva_mi.threads import one_torch_thread

Progress = Callable[..., None]
SINGLE_FRAMES = 16  # refined by one job where each is refined for itself
FEWEST_FACES = 500  # a body of fewer has no hands left


@dataclass(frozen=True)
class RefineOptions:
    """How poses are refined. Losses are divided by the person's area: see gva_mi.pose.evidence."""

    loss: Literal["sequence", "paper"] = "sequence"  # all frames together, or Eq. 9 frame by frame
    size: int = 256  # pixels of the longer side of the pictures that are compared
    faces: int = 6000  # triangles of the body that is compared with them
    passes: int = 50  # sequence: how often every frame is visited
    batch: int = 4  # sequence: frames of a step, at most
    steps: int = 80  # paper: steps for each frame
    silhouette: float = 5.0  # λ1
    paper_prior: float = 0.5  # paper: λ2, for one square radian
    prior: float = 0.3  # sequence: λ2, for one square metre that a joint's turn moves
    smooth: float = 200.0  # sequence: between neighbours' turns, for one square metre
    smooth_move: float = 200.0  # sequence: between neighbours' places, for one square metre
    hold: float = 3.0  # sequence: pull of the translation to stage 1, for one square metre
    jitter: float = 0.03  # sequence: metres between frames: less is no motion of a joint
    jitter_move: float = 0.02  # sequence: metres between frames: less is no motion of the person
    outlier: float = 0.005  # sequence: metres beyond which a jump between frames counts less
    reach: float = 2.2  # sequence: √λ, frames over which a step spreads to both sides
    cloth_smooth: float = 1.6e-4  # sequence: a of the displacement's energy, for one (1/m)²
    cloth_small: float = 40.0  # sequence: b
    cloth_outward: float = 400.0  # sequence: c
    betas_prior: float = 0.05  # sequence: λβ, for one squared standard deviation
    step: float = 0.012  # metres that a turned joint moves what hangs on it, in a step at the start
    largest_turn: float = 0.03  # radians in such a step; joints with short levers are held by it
    translation_lr: float = 0.006  # metres in a step at the start; depth is seen weakly
    cloth_lr: float = 0.002  # metres in a step at the start
    betas_lr: float = 0.02  # sequence: standard deviations in a step at the start
    part: int = 240  # sequence: frames refined together; a longer video is cut into parts
    overlap: int = 16  # frames that a part shares with the next
    skim: int = 96  # frames of a longer video that tell what all its parts share
    seed: int = 0  # of the order in which frames are visited

    def __post_init__(self) -> None:
        if self.loss not in ("sequence", "paper"):
            raise InputError(f"refine: loss must be 'sequence' or 'paper', got {self.loss!r}")
        least = {"size": 1, "faces": FEWEST_FACES, "passes": 1, "batch": 1, "steps": 1}
        for name, smallest in least.items():
            found = getattr(self, name)
            if found < smallest:
                raise InputError(f"refine: {name} must be at least {smallest}, got {found}")
        for name in ("jitter", "jitter_move", "outlier"):
            if not getattr(self, name) > 0:
                raise InputError(f"refine: {name} must be above 0, got {getattr(self, name)}")
        if not 0 <= 2 * self.overlap < self.part or self.skim < 1:
            raise InputError(
                "refine: overlap must be less than half a part, and skim at least 1; "
                f"got overlap {self.overlap}, part {self.part}, skim {self.skim}"
            )


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
    seconds_per_frame: float  # of work, by all workers together


def refine(
    video: Video,
    body: BodyModel,
    options: RefineOptions,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Refined:
    """Refine the poses of all frames of a video.

    Args:
        video: frames, cameras, masks, perhaps normals, and stage-1 poses.
        body: the body that the poses move.
        options: how.
        progress: called as ``progress(done, total, **figures)`` as the work goes on.
        executor: who does independent work; None: this process.

    Returns:
        Poses of all frames. A frame that cannot be refined keeps its stage-1 pose and is listed in
        ``kept``: an empty mask, a body out of view, or a loss that did not fall below stage 1's.
    """
    return next(refine_all([(video, options)], body, progress, executor))


def refine_all(
    tasks: Sequence[tuple[Video, RefineOptions]],
    body: BodyModel,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[Refined]:
    """Refine several videos, at the same time where there is an executor.

    Args:
        tasks: the videos, and how each is refined.
        body: the body that all poses move.
        progress: called as ``progress(done, total, **figures)`` with the steps of all of them.
        executor: who does independent work; None: this process.

    Returns:
        What came of each, in their order and as soon as it is done.
    """
    coarse = {faces: CoarseBody(body, faces) for faces in {o.faces for _, o in tasks}}
    cases = [_Case.of(video, coarse[options.faces], options) for video, options in tasks]
    first = [case.skim_jobs() for case in cases]
    second = [case.part_jobs() for case in cases]
    steps_first, steps_second = (
        sum(job.steps for jobs in of_cases for job in jobs) for of_cases in (first, second)
    )
    total = steps_first + steps_second
    tell = lambda done, **figures: progress and progress(done, total, **figures)
    tell_later = lambda done, **figures: tell(steps_first + done, **figures)

    found = run([job for jobs in first for job in jobs], executor, tell)
    skimmed = [[next(found) for _ in jobs] for jobs in first]
    for jobs, of_case in zip(second, skimmed, strict=True):
        for solved in of_case:  # one, or none
            jobs[:] = [replace(job, known=solved.solution) for job in jobs]
    found = run([job for jobs in second for job in jobs], executor, tell_later)
    for case, of_case, jobs in zip(cases, skimmed, second, strict=True):
        yield case.finished(of_case, [next(found) for _ in jobs])


@dataclass(frozen=True)
class _Case:
    """One video on its way."""

    frames: int
    coarse: CoarseBody
    pose: Pose  # stage 1
    shape: Shape
    options: RefineOptions
    targets: dict[int, Target]
    kept: dict[int, str]
    parts: list[range]
    seconds: float  # of preparation

    @staticmethod
    def of(video: Video, coarse: CoarseBody, options: RefineOptions) -> _Case:
        """Look at all frames, and cut the video."""
        begin = time.perf_counter()
        with one_torch_thread():
            targets, kept = _targets(video, coarse.body, options.size)
        if options.loss == "sequence":
            parts = cut(len(video), options.part, options.overlap)
        else:
            parts = cut(len(video), SINGLE_FRAMES, 0)
        pose, shape = video.pose.to(torch.float32), Shape(video.shape.betas.to(torch.float32))
        seconds = time.perf_counter() - begin
        return _Case(len(video), coarse, pose, shape, options, targets, kept, parts, seconds)

    def skim_jobs(self) -> list[Job]:
        """The first round of a long video (:mod:`gva_mi.pose.clips`); a short one has none."""
        if len(self.parts) == 1 or self.options.loss != "sequence":
            return []
        there = sorted(self.targets)
        seen = [there[i] for i in skim(len(there), self.options.skim)]
        targets = {k: self.targets[k] for k in seen}
        return [Job(targets, self.coarse.body, self.pose, self.shape, self.options)]

    def part_jobs(self) -> list[Job]:
        """What is left to do once the first round is done."""
        jobs = []
        for part in self.parts:
            targets = {k - part.start: self.targets[k] for k in part if k in self.targets}
            pose = self.pose[slice(part.start, part.stop)]
            jobs.append(Job(targets, self.coarse.body, pose, self.shape, self.options))
        return jobs

    def finished(self, skimmed: Sequence[Solved], found: Sequence[Solved]) -> Refined:
        """Join the parts, and keep stage 1 where they are no better."""
        begin = time.perf_counter()
        solutions = [solved.solution for solved in found]
        joined = join(self.parts, [s.rotations for s in solutions], [s.transl for s in solutions])
        rotations, transl = (x.clone() for x in joined)
        shared = skimmed[0].solution if skimmed else solutions[0]
        offsets, betas = shared.offsets, shared.betas
        losses_stage1 = self._losses(
            Solution(self.pose.rotations, self.pose.transl, offsets, betas)
        )
        losses = self._losses(Solution(rotations, transl, offsets, betas))
        kept = dict(self.kept)
        for k in self.targets:
            if not losses[k] <= losses_stage1[k]:  # NaN counts as worse
                kept[k] = f"its loss grew from {losses_stage1[k]:.3f} to {losses[k]:.3f}"
        for k in kept:
            rotations[k], transl[k] = self.pose.rotations[k], self.pose.transl[k]
        work = self.seconds + sum(solved.seconds for solved in (*skimmed, *found))
        return Refined(
            Pose(rotations, transl, self.pose.expression),
            Shape(betas),
            self.coarse.spread(offsets),
            losses_stage1,
            losses,
            dict(sorted(kept.items())),
            [k for k, target in self.targets.items() if target.normals is None],
            (work + time.perf_counter() - begin) / self.frames,
        )

    @torch.no_grad()
    def _losses(self, solution: Solution) -> Tensor:
        """L_normal + λ1 L_silhouette of each frame (T,); NaN where there is no target."""
        losses = torch.full((self.frames,), torch.nan)
        body = self.coarse.body
        scene = MeshScene(body.faces, body.v_template)
        with one_torch_thread():
            for k, target in self.targets.items():
                one = Pose(
                    solution.rotations[k : k + 1],
                    solution.transl[k : k + 1],
                    self.pose.expression[k : k + 1],
                )
                vertices = body(one, Shape(solution.betas), solution.offsets).vertices[0]
                image = scene.render(vertices, target.camera)
                silhouette = self.options.silhouette * target.silhouette_loss(image)
                losses[k] = target.normal_loss(image) + silhouette
        return losses


def _targets(video: Video, body: BodyModel, size: int) -> tuple[dict[int, Target], dict[int, str]]:
    """What each frame says, and the frames that say nothing."""
    targets, kept = {}, dict(video.absent)
    for frame in video.frames(k for k in range(len(video)) if k not in video.absent):
        with torch.no_grad():
            vertices = body(frame.pose, video.shape).vertices[0]
        try:
            targets[frame.index] = Target.of(frame, size, vertices)
        except CannotRefine as reason:
            kept[frame.index] = str(reason)
    return targets, kept
