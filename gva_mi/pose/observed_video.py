"""Refinement of one video: gather evidence, make the tasks, join their results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.cpu import one_thread
from gva_mi.core.spill_cache import SpillCache
from gva_mi.core.tasks import Done
from gva_mi.data.crop import gather
from gva_mi.data.fingerprint import FILM
from gva_mi.data.video import Outline, Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.surface import CoarseBody
from gva_mi.pose.clips import cut, join, skim
from gva_mi.pose.evidence.close_ups import FinePicture, close_up_scale, parts_of
from gva_mi.pose.evidence.landmarks import SeenLandmarks
from gva_mi.pose.evidence.masks_normals import MaskAndNormals, common_scale, frame_loss
from gva_mi.pose.job import RefineJob, RefineOptions, Solution
from gva_mi.pose.optimize import worse_frames
from gva_mi.pose.prior.error_model import Stage1ErrorModel
from gva_mi.pose.prior.film_errors import FPS, film_errors
from gva_mi.pose.sequence import SequenceOptions, refine_sequence, repeats
from gva_mi.pose.single_frame import FRAMES_A_JOB, refine_single_frames
from gva_mi.pose.stage1 import Stage1
from gva_mi.pose.stature import with_height
from gva_mi.pose.swaps import fix_swaps
from gva_mi.splat import Camera

# Nats by which a frame must speak against its refined pose, where stage 1 was made from the same
# landmarks: it agrees with them by more than the true pose does, and its neighbours know better.
SURE = 4.0


@dataclass(frozen=True, kw_only=True)
class Refined(Solution):
    """Solution of all frames after stage 2, and figures of the refinement."""

    losses_stage1: Tensor  # (T,) of the evidence at stage 1; NaN where there is none
    losses: Tensor  # (T,) the data term at the poses found, rejected ones included
    kept: dict[int, str]  # frames that keep their stage-1 pose, and why
    without_normals: list[int]  # frames that were fitted to their silhouette alone
    seconds_per_frame: float  # summed over all workers
    cameras: list[Camera] | None = None  # that the poses are for, if not the video's
    held_out: list[int] = field(default_factory=list)  # test frames that were not used
    # Pairs of limbs that stage 1 had swapped, and in which frames.
    swapped: Mapping[str, Sequence[int]] = field(default_factory=dict)


@dataclass(frozen=True)
class RefineTask:
    """A job and its options: a :class:`gva_mi.core.tasks.Task`."""

    job: RefineJob
    options: RefineOptions
    processes: int = 1  # that share its frames

    @property
    def steps(self) -> int:
        return _steps(self.options, len(self.job.evidence))

    def solve(self, progress: Progress | None = None) -> Solution:
        job = self.job
        if not job.evidence:
            return Solution(job.pose, job.shape, torch.zeros_like(job.body.v_template))
        in_memory = replace(job, evidence=dict(job.evidence), fine=dict(job.fine))
        with one_thread():
            if isinstance(self.options, SequenceOptions):
                return refine_sequence(in_memory, self.options, progress, self.processes)
            return refine_single_frames(in_memory, self.options, progress)


@dataclass(frozen=True)
class ObservedVideo:
    """A video with its evidence, which is refined in two rounds."""

    coarse: CoarseBody
    pose: Pose  # stage 1 at the known height, with swapped limbs fixed
    shape: Shape
    options: RefineOptions
    evidence: SpillCache[MaskAndNormals]
    pictures: SpillCache[FinePicture]  # of the frames that have evidence, if there are close-ups
    kept: dict[int, str]  # frames without evidence, and why
    held_out: Sequence[int]  # test frames that are not used
    landmarks: SeenLandmarks | None
    errors: Mapping[str, Stage1ErrorModel] | None  # of the estimator, if they are known
    swapped: Mapping[str, Sequence[int]]  # limbs that were fixed, and in which frames
    seconds: float  # time to gather the evidence

    @staticmethod
    def of(
        video: Video, simplified: Callable[[int, bool], CoarseBody], options: RefineOptions
    ) -> ObservedVideo:
        """Gather the evidence of all frames."""
        begin = time.perf_counter()
        in_sequence = isinstance(options, SequenceOptions)
        hand_size = options.close_up_size if in_sequence else 0
        coarse = simplified(options.faces, hand_size > 0)

        def body_at(outline: Outline) -> Tensor:
            return coarse.body(outline.pose, video.shape).vertices[0]

        def look(outline: Outline) -> MaskAndNormals:
            points = body_at(outline)
            whole = MaskAndNormals.of(outline, scale, points)
            if fine is not None:
                pictures[outline.index] = FinePicture.of(outline, fine, points, of_film)
            return whole

        of_film = video.kind == FILM
        held_out = list(video.splits.test) if options.hold_out_test else []
        evidence, pictures = SpillCache(video.folder), SpillCache(video.folder)
        frames = [k for k in range(len(video)) if k not in held_out]
        with one_thread(), torch.no_grad():
            scale = common_scale(video, frames, options.size, body_at)
            person = coarse.body, video.pose, video.shape, video.cameras
            fine = close_up_scale(*person, scale, hand_size) if hand_size > 0 else None
            kept = gather(frames, video.absent, video.outlines, look, evidence)
        pose, shape = video.pose.to(torch.float32), Shape(video.shape.betas.to(torch.float32))
        if options.height is not None:
            pose, shape = with_height(coarse.body, pose, shape, video.cameras, options.height)
        # Without close-ups, hands and feet need no more triangles than the rest.
        compared = coarse if pictures else simplified(options.faces, False)
        landmarks = None
        if in_sequence and options.landmarks > 0 and video.landmarks is not None:
            fps = video.fps or FPS
            seen = video.landmarks, compared.body, video.cameras, fps
            landmarks = SeenLandmarks.of(*seen, (pose, shape))
        swapped: dict[str, list[int]] = {}
        if in_sequence and options.unswap:
            bare = Solution(pose, shape, torch.zeros_like(compared.body.v_template))
            losses = lambda p: _losses(compared.body, evidence, landmarks, options, p, bare)
            stage1 = Stage1.of(pose, range(len(pose)), video.cameras[0])
            pose, swapped = fix_swaps(stage1, losses, options.prior_weight)
        seconds = time.perf_counter() - begin
        errors = known_errors(video, options) if in_sequence else None
        known = evidence, pictures, kept, held_out, landmarks, errors, swapped, seconds
        return ObservedVideo(compared, pose, shape, options, *known)

    @property
    def clips(self) -> list[range]:
        """The pieces that are solved as separate jobs."""
        frames, options = len(self.pose), self.options
        if isinstance(options, SequenceOptions):
            return cut(frames, options.part, options.overlap)
        return cut(frames, FRAMES_A_JOB, 0)

    @property
    def clip_steps(self) -> int:
        """The steps of the second round."""
        return sum(_steps(self.options, len(self.evidence.part(clip))) for clip in self.clips)

    def first_task(self) -> RefineTask | None:
        """Return the task that precedes the clips; None if there is none."""
        if len(self.clips) == 1 or not isinstance(self.options, SequenceOptions):
            return None
        seen = sorted(self.evidence)
        frames = [seen[i] for i in skim(len(seen), self.options.skim)]
        if not frames:
            return None
        return self._task(frames, 0, self.pose)

    def clip_tasks(self, known: Done[Solution] | None) -> list[RefineTask]:
        """Return the tasks of the clips, once the first round is done."""
        return [
            self._task(
                clip,
                clip.start,
                self.pose[clip.start : clip.stop],
                known=None if known is None else known.result,
                following=[k - clip.start for k in clip if k in self.held_out],
            )
            for clip in self.clips
        ]

    def _task(
        self,
        frames: Sequence[int],
        first: int,
        pose: Pose,
        **more: Any,  # noqa: ANN401
    ) -> RefineTask:
        """Return the task of some frames, numbered from ``first`` on, as in ``pose``."""
        landmarks = self.landmarks
        job = RefineJob(
            self.evidence.part(frames, first),
            self.coarse.body,
            pose,
            self.shape,
            fine=self.pictures.part(frames, first),
            landmarks=landmarks and landmarks.part(range(first, first + len(pose))),
            errors=self.errors,
            **more,
        )
        return RefineTask(job, self.options)

    def finished(self, known: Done[Solution] | None, found: Sequence[Done[Solution]]) -> Refined:
        """Join the clips, and keep stage 1 in frames whose loss did not fall."""
        begin = time.perf_counter()
        shared = (known or found[0]).result
        pose = join(self.clips, [done.result.pose for done in found])
        losses_stage1, losses = (
            _losses(self.coarse.body, self.evidence, self.landmarks, self.options, p, shared)
            for p in (self.pose, pose)
        )
        margin = 0.0 if self.errors is None else SURE * self.options.prior_weight
        worse = worse_frames(self.evidence, losses_stage1, losses, margin=margin)
        kept = self.kept | worse
        taken = [k for k in (*self.evidence, *self.held_out) if k not in kept]
        pose = self.pose.with_frames(taken, pose[taken])
        work = self.seconds + sum(done.seconds for done in (*found, *([known] if known else [])))
        shared = replace(shared, pose=pose, offsets=self.coarse.spread(shared.offsets))
        return Refined(
            **vars(shared),
            losses_stage1=losses_stage1,
            losses=losses,
            kept=dict(sorted(kept.items())),
            without_normals=[k for k, seen in self.evidence.items() if seen.normals is None],
            seconds_per_frame=(work + time.perf_counter() - begin) / len(self.pose),
            held_out=list(self.held_out),
            swapped=self.swapped,
        )


def known_errors(video: Video, options: SequenceOptions) -> Mapping[str, Stage1ErrorModel] | None:
    """Return the error model of the estimator that made the poses; None: it is inferred."""
    by_solver = options.errors == "film" or (options.errors == "auto" and video.kind == FILM)
    return film_errors(video.fps or FPS) if by_solver else None


def _steps(options: RefineOptions, frames: int) -> int:
    """Return the steps that so many frames take, for progress."""
    if isinstance(options, SequenceOptions):
        return frames * options.passes * repeats(frames)
    return frames * options.steps


@torch.no_grad()
def _losses(
    body: BodyModel,
    evidence: Mapping[int, MaskAndNormals],
    landmarks: SeenLandmarks | None,
    options: RefineOptions,
    pose: Pose,
    person: Solution,
) -> Tensor:
    """Return the evidence's loss (T,) in T poses, without close-ups; NaN where there is none."""
    losses = torch.full((len(pose),), torch.nan)
    scene, transforms = MeshScene(body.faces, body.v_template), []
    with one_thread():
        for k, seen in evidence.items():
            posed = body(pose[k], person.shape, person.offsets)
            views = [(1.0, seen)]
            losses[k], _ = frame_loss(scene, posed.vertices[0], views, options.silhouette, False)
            transforms.append(posed.T_world_rest)
        if landmarks is not None and transforms:
            offsets = person.landmark_offsets
            offsets = torch.zeros_like(landmarks.rig.rest) if offsets is None else offsets
            frames = list(evidence)
            off = landmarks.losses(frames, torch.cat(transforms), person.shape, offsets)
            losses[frames] += options.landmarks * off
    return losses


def simplified_body(body: BodyModel, faces: int, close_ups: bool) -> CoarseBody:
    """Return the body that is compared, finer at hands and feet if there are close-ups."""
    finer = torch.cat([part.vertices for part in parts_of(body)]) if close_ups else None
    return CoarseBody(body, faces, finer)
