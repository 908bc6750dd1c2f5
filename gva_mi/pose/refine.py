"""Stage 2 of the paper (Eq. 8): poses made to agree with normals and silhouettes.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

with the normals ``N`` and the silhouette ``S`` of the posed body, rendered by
:mod:`gva_mi.mesh.mesh_scene`.

There are two ways, each chosen by the type of its options:

* :class:`gva_mi.pose.sequence.SequenceOptions`: all frames together, with corrections of stage 1
  that are slow in time (:mod:`gva_mi.pose.corrections`), one displacement of the rest surface for
  the clothes, and the person's shape. The paper's Eq. 8 fits a bare body to the mask of a clothed
  one, and on such a person it makes poses worse than stage 1.
* :class:`gva_mi.pose.single_frame.SingleFrameOptions`: Eq. 8 as printed, frame by frame, the bare
  body, rotations only.

Frames of all splits are refined alike, from their own masks and normals. Frames without normals are
fitted to their silhouettes alone.

Single frames, clips of long videos (:mod:`gva_mi.pose.clips`) and the videos of several subjects
are independent of each other, and may be refined at the same time (:mod:`gva_mi.pose.parallel`).
How the work is cut does not depend on who does it: any number of workers finds the same poses.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cache, partial

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress, within
from gva_mi.data.video import Outline, Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.clips import join, of_clip, poses_of_clip
from gva_mi.pose.close_ups import FinePicture, close_up_scale, parts_of
from gva_mi.pose.coarse_body import CoarseBody
from gva_mi.pose.descent import with_frames, worse_frames
from gva_mi.pose.evidence import MaskAndNormals, common_scale, gather, mean_loss, seen_body
from gva_mi.pose.focal import follow
from gva_mi.pose.ground import Footing
from gva_mi.pose.job import Job, RefineOptions, Solution
from gva_mi.pose.noise import Noise
from gva_mi.pose.parallel import Done, run
from gva_mi.pose.stage1 import Stage1
from gva_mi.pose.stature import with_height
from gva_mi.pose.swaps import put_right
from gva_mi.shelf import Shelf
from gva_mi.splat import Camera
from gva_mi.threads import one_torch_thread


@dataclass(frozen=True)
class Refined:
    """Poses after stage 2, and what is known of how they came about."""

    pose: Pose  # all frames
    shape: Shape
    offsets: Tensor  # (V, 3) displacement of the rest surface, shared by all frames, metres
    losses_stage1: Tensor  # (T,) the data term of Eq. 8 at stage 1; NaN where there is no evidence
    losses: Tensor  # (T,) the same at the poses that were found, also those that were not taken
    kept: dict[int, str]  # frames that keep their stage-1 pose, and why
    without_normals: list[int]  # frames that were fitted to their silhouette alone
    seconds_per_frame: float  # of work, by all workers together
    cameras: list[Camera] | None = None  # of all frames where they were refined too; else as given
    held_out: list[int] = field(default_factory=list)  # test frames that were not looked at
    noise: Mapping[str, Noise] = field(default_factory=dict)  # of stage 1, where it was inferred
    footing: Footing | None = None  # how the person stands on the ground, likewise
    focal: float = 1.0  # factor on the focal lengths of the video's cameras, as it was found
    # Pairs of limbs that stage 1 had taken for each other, and in which frames.
    swapped: Mapping[str, Sequence[int]] = field(default_factory=dict)


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
        options: ``SequenceOptions`` or ``SingleFrameOptions``, whose type chooses the way.
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
    simplified = cache(partial(_simplified, body))  # videos share what is made alike
    videos = [_SeenVideo.of(video, simplified, options) for video, options in tasks]
    first = [video.first_job() for video in videos]
    steps = sum(job.steps for job in first if job is not None)
    later = sum(video.clip_steps for video in videos)

    # The first round finds what the clips of a long video share, the second their poses.
    found = run(
        [job for job in first if job is not None],
        executor,
        within(progress, 0, steps, steps + later),
    )
    known = [None if job is None else next(found) for job in first]
    second = [video.clip_jobs(of_video) for video, of_video in zip(videos, known, strict=True)]
    found = run(
        [job for jobs in second for job in jobs],
        executor,
        within(progress, steps, later, steps + later),
    )
    for video, of_video, jobs in zip(videos, known, second, strict=True):
        yield video.finished(of_video, [next(found) for _ in jobs])


@dataclass(frozen=True)
class _SeenVideo:
    """A video whose frames have been looked at, on its way through the two rounds."""

    coarse: CoarseBody
    pose: Pose  # stage 1, brought to the person's height where it is known, with limbs put right
    shape: Shape
    cameras: Sequence[Camera]
    options: RefineOptions
    evidence: Shelf[MaskAndNormals]
    pictures: Shelf[FinePicture]  # of the frames that have evidence, where there are close-ups
    kept: dict[int, str]  # frames without evidence, and why
    held_out: dict[int, str]  # test frames that are not looked at
    swapped: Mapping[str, Sequence[int]]  # limbs that were put right, and in which frames
    seconds: float  # of looking

    @staticmethod
    def of(
        video: Video, simplified: Callable[[int, bool], CoarseBody], options: RefineOptions
    ) -> _SeenVideo:
        """Look at all frames."""
        begin = time.perf_counter()
        coarse = simplified(options.faces, options.close_up_size > 0)

        def body_at(outline: Outline) -> Tensor:
            return coarse.body(outline.pose, video.shape).vertices[0]

        def look(outline: Outline) -> MaskAndNormals:
            points = body_at(outline)
            whole = MaskAndNormals.of(outline, scale, points)
            if fine is not None:
                pictures[outline.index] = FinePicture.of(outline, fine, points)
            return whole

        held_out = _held_out(video, options)
        evidence, pictures = Shelf(video.folder), Shelf(video.folder)
        frames = [k for k in range(len(video)) if k not in held_out]
        with one_torch_thread(), torch.no_grad():
            scale = common_scale(video, frames, options.size, body_at)
            fine = _fine_scale(video, coarse.body, options, scale)
            kept = gather(frames, video.absent, video.outlines, look, evidence)
        pose, shape = video.pose.to(torch.float32), Shape(video.shape.betas.to(torch.float32))
        if options.height is not None:
            pose, shape = with_height(coarse.body, pose, shape, video.cameras, options.height)
        # Where there is nothing to look at more closely, triangles serve better elsewhere.
        compared = coarse if pictures else simplified(options.faces, False)
        swapped: dict[str, list[int]] = {}
        if options.swap_nat is not None:
            bare = Solution(pose, shape, torch.zeros_like(compared.body.v_template))
            losses = lambda p: _losses(compared.body, evidence, options.silhouette, p, bare)
            stage1 = Stage1.of(pose, range(len(pose)), video.cameras[0])
            pose, swapped = put_right(stage1, losses, options.swap_nat)
        seconds = time.perf_counter() - begin
        return _SeenVideo(
            compared,
            pose,
            shape,
            video.cameras,
            options,
            evidence,
            pictures,
            kept,
            held_out,
            swapped,
            seconds,
        )

    @property
    def clips(self) -> list[range]:
        return self.options.clips(len(self.pose))

    @property
    def clip_steps(self) -> int:
        """How much work the second round is."""
        seen = [len(self.evidence.part(clip)) for clip in self.clips]
        return sum(map(self.options.steps_for, seen))

    def first_job(self) -> Job | None:
        """What is solved before the clips, if anything is."""
        frames = self.options.first_round(len(self.pose), sorted(self.evidence))
        evidence, pictures = self.evidence.part(frames), self.pictures.part(frames)
        if not evidence:
            return None
        return Job(evidence, self.coarse.body, self.pose, self.shape, self.options, fine=pictures)

    def clip_jobs(self, known: Done[Solution] | None) -> list[Job]:
        """The clips' jobs, once the first round is done."""
        shared = None if known is None else known.result
        return [
            Job(
                self.evidence.part(clip, clip.start),
                self.coarse.body,
                poses_of_clip(clip, self.pose),
                self.shape,
                self.options,
                shared,
                self.pictures.part(clip, clip.start),
                list(of_clip(clip, self.held_out)),
            )
            for clip in self.clips
        ]

    def finished(self, known: Done[Solution] | None, found: Sequence[Done[Solution]]) -> Refined:
        """Join the clips, and keep stage 1 in the frames that they made no better."""
        begin = time.perf_counter()
        shared = (known or found[0]).result
        pose = join(self.clips, [done.result.pose for done in found])
        losses_stage1, losses = (
            _losses(self.coarse.body, self.evidence, self.options.silhouette, p, shared)
            for p in (self.pose, pose)
        )
        kept = self.kept | worse_frames(self.evidence, losses_stage1, losses)
        taken = [k for k in (*self.evidence, *self.held_out) if k not in kept]
        pose = with_frames(self.pose, taken, pose[taken])
        if shared.focal != 1:
            pelvis = self.coarse.body.rest(shared.shape).joints[0]
            pose = follow(pose, pelvis, self.cameras, shared.focal)
        work = self.seconds + sum(done.seconds for done in (*found, *([known] if known else [])))
        return Refined(
            pose=pose,
            shape=shared.shape,
            offsets=self.coarse.spread(shared.offsets),
            focal=shared.focal,
            cameras=[c.zoomed(shared.focal) for c in self.cameras] if shared.focal != 1 else None,
            losses_stage1=losses_stage1,
            losses=losses,
            kept=dict(sorted(kept.items())),
            without_normals=[k for k, seen in self.evidence.items() if seen.normals is None],
            seconds_per_frame=(work + time.perf_counter() - begin) / len(self.pose),
            held_out=list(self.held_out),
            noise=shared.noise,
            footing=shared.footing,
            swapped=self.swapped,
        )


@torch.no_grad()
def _losses(
    body: BodyModel,
    evidence: Mapping[int, MaskAndNormals],
    silhouette: float,
    pose: Pose,
    person: Solution,
) -> Tensor:
    """The data term of Eq. 8 (T,) of a person in T poses; NaN where there is no evidence."""
    losses = torch.full((len(pose),), torch.nan)
    scene = MeshScene(body.faces, body.v_template)
    focal = None if person.focal == 1 else torch.tensor(person.focal)
    with one_torch_thread():
        for k, seen in evidence.items():
            who = body, pose[k], person.shape, person.offsets
            vertices = seen_body(*who, [seen], focal)
            losses[k] = mean_loss(scene, vertices, [seen], silhouette, focal=focal)
    return losses


def _held_out(video: Video, options: RefineOptions) -> dict[int, str]:
    """The frames that must not be looked at, and why."""
    if not options.hold_out_test:
        return {}
    return {k: "it is a test frame, and held out" for k in video.splits.test}


def _simplified(body: BodyModel, faces: int, close_ups: bool) -> CoarseBody:
    """The body that is compared, finer where there are close-ups."""
    finer = torch.cat([part.vertices for part in parts_of(body)]) if close_ups else None
    return CoarseBody(body, faces, finer)


def _fine_scale(
    video: Video, body: BodyModel, options: RefineOptions, scale: float
) -> float | None:
    """The scale of the pictures that close-ups are cut from; None where there are none."""
    if options.close_up_size == 0:
        return None
    size = options.close_up_size
    return close_up_scale(body, video.pose, video.shape, video.cameras, scale, size)
