"""Stage 2 of the paper (Eq. 8): refine poses until they agree with normals and silhouettes.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

with the normals ``N`` and the silhouette ``S`` of the posed body, rendered by
:mod:`gva_mi.mesh.mesh_scene`. The type of the options chooses one of two methods:

* :mod:`gva_mi.refine.sequence`: all frames together, with corrections of stage 1 that are smooth in
  time, one displacement of the rest surface for the clothes, and the person's shape. Eq. 8 fits a
  bare body to the mask of a clothed person, which makes such poses worse than stage 1.
* :mod:`gva_mi.refine.single_frame`: Eq. 8 as printed, frame by frame, the bare body, rotations
  only.

Frames of all splits are refined in the same way, from their own masks and normals; frames without
normals from their silhouettes alone. A job refines one clip of a video
(:mod:`gva_mi.refine.clips`). Jobs run one after the other, and processes share the frames of each
step (:mod:`gva_mi.refine.frame_losses`): any number finds the same poses. The processes start while
the evidence is gathered, and stay for all jobs.

Some estimators assume another lens in each frame. Their poses jump by metres from frame to frame
while the person stands still (:mod:`gva_mi.readers.track`), and the prior would take that for
errors and for motion. So the person is placed before the median lens, where the pictures show the
same (:func:`before_one_lens`), refined there, and placed back (:func:`moved_between_lenses`). The
lenses differ by some percent: nothing else in the pictures changes visibly.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.rotations import composed, shortest
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.cpu import one_thread
from gva_mi.core.tasks import Done, Helpers, helper_processes, run
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.clips import cut, join, skim
from gva_mi.refine.observed_video import ObservedVideo, RefineOptions, simplified_body
from gva_mi.refine.optimize import worse_frames
from gva_mi.refine.sequence import (
    ObservedClip,
    SequenceOptions,
    Solution,
    frames_a_step,
    refine_sequence,
    repeats,
    shape_precision,
)
from gva_mi.refine.single_frame import FRAMES_A_JOB, refine_single_frames
from gva_mi.refine.uncertainty import STRIDE, Posterior, Uncertainty
from gva_mi.splat import Camera
from gva_mi.subject.lens import is_one_lens, seen_alike
from gva_mi.subject.video import Video

# A frame keeps its stage-1 pose if its loss grew by more than this, in nats, and the errors of
# stage 1 are known. Chosen above 0: our stage 1 was solved from the same landmarks, so it agrees
# with them better than the true pose does.
KEPT_LOSS_MARGIN = 4.0
# Losses of frames from which helper processes pay. Chosen by eye.
SHARED_LOSSES = 1000


@dataclass(frozen=True, kw_only=True)
class Refined(Solution):
    """Solution of all frames after stage 2, and figures of the refinement."""

    losses_stage1: Tensor  # (T,) of the evidence at the stage-1 poses; NaN without evidence
    losses: Tensor  # (T,) of the evidence at the poses found, rejected ones included
    kept: dict[int, str]  # frames that keep their stage-1 pose, and why
    without_normals: list[int]  # frames that were fitted to their silhouettes alone
    seconds_per_frame: float  # summed over all workers
    cameras: list[Camera] | None = None  # that the poses are for, if not the video's
    held_out: list[int] = field(default_factory=list)  # test frames that were not used
    # "legs" or "arms" that stage 1 had swapped, and in which frames.
    swapped: Mapping[str, Sequence[int]] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None  # None without a prior


def refine(
    video: Video, body: BodyModel, options: RefineOptions, progress: Progress | None = None
) -> Refined:
    """Refine the poses of all frames of a video.

    Args:
        video: frames, cameras, masks, perhaps normals, and stage-1 poses.
        body: the body that the poses move.
        options: ``SequenceOptions`` or ``SingleFrameOptions``; the type chooses the method.
        progress: called as ``progress(done, total, **figures)`` as the work goes on.

    Returns:
        Poses of all frames. A frame that cannot be refined keeps its stage-1 pose and is listed in
        ``kept``: an empty mask, a body out of view, or a loss that did not fall below stage 1's.
    """
    return next(refine_all([video], body, options, progress))


def refine_all(
    videos: Sequence[Video],
    body: BodyModel,
    options: RefineOptions,
    progress: Progress | None = None,
    workers: int = 1,
) -> Iterator[Refined]:
    """Refine several videos with one body.

    A long video takes two rounds: the first finds what its clips share, the second their poses.

    Args:
        videos: with stage-1 poses.
        body: the body that all poses move.
        options: as of :func:`refine`.
        progress: called as ``progress(done, total, **figures)`` with the steps of all videos.
        workers: processes that share the frames of a step, this one included. Eq. 8 frame by
            frame always runs in this process.

    Returns:
        The results in the order of the videos, each as soon as it is done.
    """
    pays = False
    if isinstance(options, SequenceOptions):
        counts = [len(video) for video in videos]
        losses = sum(count * repeats(count) * options.passes for count in counts)
        most = max((frames_a_step(count, options) for count in counts), default=1)
        workers = min(workers, most)
        pays = losses >= SHARED_LOSSES
    with helper_processes(workers, pays) as helpers:
        yield from _refined_all(videos, body, options, progress, helpers)


def _refined_all(
    videos: Sequence[Video],
    body: BodyModel,
    options: RefineOptions,
    progress: Progress | None,
    helpers: Helpers,
) -> Iterator[Refined]:
    """Yield what :func:`refine_all` yields."""
    simplified = cache(partial(simplified_body, body))  # shared by the videos
    placed = [before_one_lens(video, body) for video in videos]
    observed = [ObservedVideo.of(video, simplified, options) for video in placed]
    skims = {k: job for k, video in enumerate(observed) if (job := _skim_job(video))}
    steps = sum(job.steps for job in skims.values())
    total = steps + sum(_steps(x, len(x.evidence.part(c))) for x in observed for c in _clips(x))
    report = part_of_progress(progress, 0, steps, total)
    skimmed = dict(zip(skims, _solved(list(skims.values()), helpers, report), strict=True))
    jobs = [_clip_jobs(video, skimmed.get(k)) for k, video in enumerate(observed)]
    report = part_of_progress(progress, steps, total - steps, total)
    found = _solved([job for clips in jobs for job in clips], helpers, report)
    for k, (video, before, clips) in enumerate(zip(videos, placed, jobs, strict=True)):
        refined = _joined(observed[k], skimmed.get(k), [next(found) for _ in clips])
        if before is not video:
            person = refined.pose, refined.shape, body
            pose = moved_between_lenses(*person, before.cameras, video.cameras)
            refined = replace(refined, pose=pose)
        yield refined


@dataclass(frozen=True)
class _ClipJob:
    """A clip and how it is refined in this process: a :class:`gva_mi.core.tasks.Task`."""

    clip: ObservedClip
    options: RefineOptions
    steps: int
    helpers: Helpers | None = None  # that share the frames of a step

    def solve(self, progress: Progress | None = None) -> Solution:
        """Refine the clip; without evidence it stays as it is."""
        clip, options = self.clip, self.options
        unchanged = Solution(clip.pose, clip.shape, torch.zeros_like(clip.body.v_template))
        if not clip.evidence:
            return unchanged
        clip = replace(clip, evidence=dict(clip.evidence), fine=dict(clip.fine))  # into memory
        with one_thread():
            if isinstance(options, SequenceOptions):
                return refine_sequence(clip, options, progress, self.helpers)
            person = clip.body, clip.pose, clip.shape
            pose = refine_single_frames(clip.evidence, *person, options, progress)
            return replace(unchanged, pose=pose)


def _solved(
    jobs: Sequence[_ClipJob], helpers: Helpers, progress: Progress | None
) -> Iterator[Done[Solution]]:
    """Solve jobs one after the other; helpers share the frames of a step."""
    return run([replace(job, helpers=helpers) for job in jobs], None, progress)


def _clips(video: ObservedVideo) -> list[range]:
    """Return the clips that are solved as separate jobs."""
    frames, options = len(video.pose), video.options
    if isinstance(options, SequenceOptions):
        return cut(frames, options.part, options.overlap)
    return cut(frames, FRAMES_A_JOB, 0)


def _steps(video: ObservedVideo, frames: int) -> int:
    """Return the number of steps that ``frames`` frames take, for progress."""
    in_sequence = isinstance(video.options, SequenceOptions)
    return frames * video.options.passes * (repeats(frames) if in_sequence else 1)


def _skim_job(video: ObservedVideo) -> _ClipJob | None:
    """Return the first round of a long video; None if there is none."""
    options, seen = video.options, sorted(video.evidence)
    if not isinstance(options, SequenceOptions) or len(_clips(video)) == 1 or not seen:
        return None
    frames = [seen[i] for i in skim(len(seen), options.skim)]
    return _ClipJob(video.clip(frames, 0, video.pose), options, _steps(video, len(frames)))


def _clip_jobs(video: ObservedVideo, skimmed: Done[Solution] | None) -> list[_ClipJob]:
    """Return the jobs of the clips, once the first round is done."""
    first_round, jobs = None if skimmed is None else skimmed.result, []
    for frames in _clips(video):
        pose = video.pose[frames.start : frames.stop]
        clip = video.clip(frames, frames.start, pose, first_round)
        jobs.append(_ClipJob(clip, video.options, _steps(video, len(clip.evidence))))
    return jobs


def _joined(
    video: ObservedVideo, skimmed: Done[Solution] | None, found: Sequence[Done[Solution]]
) -> Refined:
    """Join the clips, and keep stage 1 in frames whose loss did not fall."""
    begin, shared = time.perf_counter(), (skimmed or found[0]).result
    pose = join(_clips(video), [done.result.pose for done in found])
    losses_stage1, losses = (video.losses(p, shared) for p in (video.pose, pose))
    margin = 0.0 if video.known_errors is None else KEPT_LOSS_MARGIN * video.options.prior_weight
    kept = video.kept | worse_frames(video.evidence, losses_stage1, losses, margin=margin)
    taken = [k for k in (*video.evidence, *video.held_out) if k not in kept]
    solved = [*found, *([skimmed] if skimmed else [])]
    pose = video.pose.with_frames(taken, pose[taken])
    uncertainty = _uncertainty(video, pose, shared, found, kept)
    work = video.seconds + sum(done.seconds for done in solved) + time.perf_counter() - begin
    offsets = video.coarse.spread(shared.offsets)
    shared = replace(shared, pose=pose, offsets=offsets, variances=None)
    return Refined(
        **vars(shared),
        losses_stage1=losses_stage1,
        losses=losses,
        kept=dict(sorted(kept.items())),
        without_normals=[k for k, seen in video.evidence.items() if seen.normals is None],
        seconds_per_frame=work / len(video.pose),
        held_out=list(video.held_out),
        swapped=video.swapped,
        uncertainty=uncertainty,
    )


def _uncertainty(
    video: ObservedVideo,
    pose: Pose,
    person: Solution,
    clips: Sequence[Done[Solution]],
    kept: Mapping[int, str],
) -> Uncertainty | None:
    """Return the uncertainty of joined poses, by every STRIDE-th frame that has evidence."""
    options, frames = video.options, [k for k in sorted(video.evidence) if k not in kept][::STRIDE]
    if not isinstance(options, SequenceOptions) or not frames or options.prior_weight == 0:
        return None
    variances = torch.full((len(pose), len(JOINTS) + 3), torch.nan).double()
    for clip, done in zip(_clips(video), clips, strict=True):
        if done.result.variances is not None:  # else no frame of the clip has evidence
            variances[clip.start : clip.stop] = done.result.variances
    evidence = {k: video.evidence[k] for k in frames}
    stage1 = Stage1Poses.of(video.pose, frames, evidence[frames[0]].camera)
    of_person, body = (pose, person.shape, person.offsets), video.coarse.body
    of_shape = shape_precision(body, len(person.shape.betas), options)
    with one_thread():
        prior = stage1, variances[frames], of_shape
        return Posterior.of(evidence, body, of_person, *prior).uncertainty(len(pose))


def before_one_lens(video: Video, body: BodyModel) -> Video:
    """Return the video with one lens in all frames, and with poses that look the same through it.

    A video with one lens is returned unchanged. So is a video whose person moves no less before one
    lens: its lenses are real, for example because the camera zooms.
    """
    K = np.stack([camera.K for camera in video.cameras])
    if is_one_lens(K):
        return video
    fx, fy, cx, cy = np.median(K[:, [0, 1, 0, 1], [0, 1, 2, 2]], axis=0).tolist()
    cameras = [replace(camera, fx=fx, fy=fy, cx=cx, cy=cy) for camera in video.cameras]
    pose = moved_between_lenses(video.pose, video.shape, body, video.cameras, cameras)
    pose = pose.to(torch.float32)
    if _usual_step(pose) >= _usual_step(video.pose):
        return video
    return replace(video, cameras=cameras, pose=pose)


def moved_between_lenses(
    pose: Pose, shape: Shape, body: BodyModel, cameras: Sequence[Camera], others: Sequence[Camera]
) -> Pose:
    """Return poses that look the same through ``others`` as these do through ``cameras``.

    The person turns with the ray on which the pelvis is seen.

    Args:
        pose: T frames.
        shape: of the person.
        body: of the poses.
        cameras: T of them.
        others: T cameras at the same places, with other lenses.
    """
    pelvis = body.rest(shape).joints[0].detach().double().numpy()
    T = np.stack([camera.T_camera_world for camera in cameras])
    R, t = T[:, :3, :3], T[:, :3, 3]
    K, K_others = (np.stack([camera.K for camera in group]) for group in (cameras, others))
    places = np.einsum("nij,nj->ni", R, pose.transl.double().numpy() + pelvis) + t
    moved = seen_alike(places, K, K_others)
    back = lambda x: np.einsum("nji,nj->ni", R, x)
    rotations = pose.rotations.double().numpy().copy()
    rotations[:, 0] = composed(back(shortest(places, moved)), rotations[:, 0])
    tensor = lambda x: torch.from_numpy(x).to(pose.transl)
    return Pose(tensor(rotations), tensor(back(moved - t) - pelvis), pose.expression)


def _usual_step(pose: Pose) -> float:
    """Return the median step of the root from frame to frame, metres; 0 for a single frame."""
    steps = pose.transl.diff(dim=0).norm(dim=1)
    return float(steps.median()) if len(steps) else 0.0
