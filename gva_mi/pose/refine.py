"""Stage 2 of the paper (Eq. 8): refine poses until they agree with normals and silhouettes.

    L_pose = |N - N_pred| + λ1 |S - S_pred| + λ2 Σ_i ω_i |θ_i - θ_i^stage1|²

with the normals ``N`` and the silhouette ``S`` of the posed body, rendered by
:mod:`gva_mi.mesh.mesh_scene`. The type of the options chooses one of two methods:

* :mod:`gva_mi.pose.sequence`: all frames together, with corrections of stage 1 that are smooth in
  time, one displacement of the rest surface for the clothes, and the person's shape. Eq. 8 fits a
  bare body to the mask of a clothed person, which makes such poses worse than stage 1.
* :mod:`gva_mi.pose.single_frame`: Eq. 8 as printed, frame by frame, the bare body, rotations only.

Frames of all splits are refined in the same way, from their own masks and normals; frames without
normals from their silhouettes alone. Single frames, clips of long videos (:mod:`gva_mi.pose.clips`)
and videos are independent jobs and may run in parallel (:mod:`gva_mi.core.tasks`). The jobs do
not depend on the number of workers, so any number finds the same poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import cache, partial

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.tasks import Done, run
from gva_mi.data.video import Video
from gva_mi.pose.job import RefineOptions, Solution
from gva_mi.pose.observed_video import ObservedVideo, Refined, RefineTask, simplified_body
from gva_mi.pose.one_lens import as_filmed, before_one_lens


def refine(
    video: Video,
    body: BodyModel,
    options: RefineOptions,
    progress: Progress | None = None,
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
    return next(refine_all([(video, options)], body, progress))


def refine_all(
    tasks: Sequence[tuple[Video, RefineOptions]],
    body: BodyModel,
    progress: Progress | None = None,
    executor: Executor | None = None,
    workers: int = 1,
) -> Iterator[Refined]:
    """Refine several videos with one body, in parallel if there is an executor.

    Args:
        tasks: the videos, each with its options.
        body: the body that all poses move.
        progress: called as ``progress(done, total, **figures)`` with the steps of all of them.
        executor: runs independent jobs; None: this process.
        workers: processes that may work. If there are fewer jobs, several share the frames of each
            (:mod:`gva_mi.pose.frame_losses`), and one job alone stays in this process.

    Returns:
        The results in the order of the tasks, each as soon as it is done.
    """
    simplified = cache(partial(simplified_body, body))  # shared by videos with equal options
    given = [(before_one_lens(video, body), video) for video, _ in tasks]
    videos = [
        ObservedVideo.of(video, simplified, options)
        for (video, _), (_, options) in zip(given, tasks, strict=True)
    ]
    first = [video.first_task() for video in videos]
    steps = sum(task.steps for task in first if task is not None)
    later = sum(video.clip_steps for video in videos)

    # The first round finds what the clips of a long video share, the second their poses.
    def solved(tasks: Sequence[RefineTask], progress: Progress | None) -> Iterator[Done[Solution]]:
        shared = [replace(task, processes=max(1, workers // len(tasks))) for task in tasks]
        return run(shared, executor if len(tasks) > 1 else None, progress)

    found = solved(
        [task for task in first if task is not None],
        part_of_progress(progress, 0, steps, steps + later),
    )
    known = [None if task is None else next(found) for task in first]
    second = [video.clip_tasks(of_video) for video, of_video in zip(videos, known, strict=True)]
    found = solved(
        [task for tasks in second for task in tasks],
        part_of_progress(progress, steps, later, steps + later),
    )
    for video, lenses, of_video, tasks in zip(videos, given, known, second, strict=True):
        refined = video.finished(of_video, [next(found) for _ in tasks])
        yield as_filmed(refined, *lenses, body)
