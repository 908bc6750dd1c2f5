"""One function for each step from a video to an avatar.

Paths may be text. ``body`` is always the file of a body in SMPL-X's format. Without it, the body
that the subject or the run was made with is used, else the built-in body. An input that cannot be
used raises an InputError, one sentence, before any work.

Example:
    >>> fit("no_such_folder", "run")
    Traceback (most recent call last):
    gva_mi.core.errors.InputError: no_such_folder...
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.without_body import require_body_of
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel, body_name, load_body
from gva_mi.core.atomic import atomic_dir, folder_lock, require_writable
from gva_mi.core.console import Progress, aligned, bar, say, with_reasons
from gva_mi.core.errors import InputError
from gva_mi.core.files import make_room, require_replaceable, require_room
from gva_mi.core.tasks import helper_processes
from gva_mi.evaluate.measure import Metrics, measure_run
from gva_mi.evaluate.refinement import (
    MeasuredRefinement,
    describe,
    kept_poses,
    write_refinement,
)
from gva_mi.evaluate.report import write_report
from gva_mi.evaluate.scores import Scorer
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions
from gva_mi.fit.perceptual import find_weights
from gva_mi.fit.photometric import (
    SHARED_LOSSES,
    TRACKED_POSES,
    PhotometricOptions,
    fit_poses,
    write_tracking,
)
from gva_mi.fit.train import fit as fit_avatar
from gva_mi.readers.own_masks import MaskOptions
from gva_mi.refine import RefineOptions
from gva_mi.refine.refine import refine_all
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.stage1.prepare import PrepareVideoOptions, Stage1Record, prepare_video
from gva_mi.stage1.video_check import check_video
from gva_mi.subject.check import check_subject
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.folder import POSES, PREPARED, REFINED_POSES
from gva_mi.subject.opened import body_of, open_subject
from gva_mi.subject.problems import CheckReport, Problem
from gva_mi.subject.video import load_video


def prepare(
    video: Path | str,
    out: Path | str,
    options: PrepareVideoOptions = PrepareVideoOptions(),  # noqa: B008 (frozen)
    own_masks: MaskOptions = MaskOptions(),  # noqa: B008 (frozen)
    *,
    person: int | None = None,
    lens: str | None = None,
    body: Path | str | None = None,
    overwrite: bool = False,
) -> None:
    """Make a subject's folder from a video: frames, masks, camera, landmarks and stage-1 poses.

    Args:
        video: a video file of one person who turns around once, or a folder of its pictures.
        out: the subject's folder.
        options: what is known about the video.
        own_masks: masks that come from another program.
        person: if the video shows several, the person's number from the left; without it, the
            largest person.
        lens: focal length, as 26mm (35 mm equivalent) or in pixels; without it, the one that the
            video records, else it is estimated.
        body: a body file; without it, the built-in body.
        overwrite: replace a folder that was prepared here.

    Raises:
        InputError: the video shows no person, or ``out`` holds something else.

    Example:
        >>> prepare("video.mp4", "me/subject")  # doctest: +SKIP
    """
    video, out = Path(video), Path(out)
    require_replaceable(out, PREPARED, overwrite)
    with atomic_dir(out, PREPARED if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_video(
            folder, video, options, None if body is None else Path(body), person=person,
            lens=lens, own_masks=own_masks, progress=progress,
        )  # fmt: skip
    for note in notes:
        say(f"{video}: {note}")
    say(f"subject: {out}")


def check(
    subject: Path | str, *, body: Path | str | None = None, sheet: Path | str | None = None
) -> CheckReport:
    """Find all that is wrong with a subject's folder, and how to film it better, in one pass.

    Args:
        subject: the folder.
        body: a body file; without it, the subject's, else the built-in body.
        sheet: also write a picture (.png) of a few frames with the outlines of mask and body.

    Returns:
        All problems that were found; they are also printed.

    Example:
        >>> report = check("me/subject")  # doctest: +SKIP
        >>> report.errors  # doctest: +SKIP
        []
    """
    subject, sheet = Path(subject), None if sheet is None else Path(sheet)
    model = load_body(body_of(subject, body))
    with bar("check") as progress:
        report = check_subject(subject, model, progress, sheet)
        if not report.skipped:
            filmed = _filmed(subject, model, progress)
            # The two have the same frames, but only the first tells how to film.
            lost = [problem.frames for problem in filmed if problem.what == "person not found"]
            again = lambda problem: problem.what == "frames left out" and problem.frames in lost
            found = [*filmed, *(problem for problem in report.problems if not again(problem))]
            report.problems = sorted(found, key=lambda problem: problem.severity != "error")
    for line in report.lines(max(60, shutil.get_terminal_size().columns)):
        say(line)
    for line in report.skipped:
        say(f"{subject}: {line}")
    errors, doubts = len(report.errors), len(report.problems) - len(report.errors)
    agree = f"; mean IoU of body and masks {report.figures['iou']:.2f}" if report.figures else ""
    say(f"{subject}: {report.frames} frames, {errors} errors, {doubts} doubtful{agree}")
    if sheet is not None and not report.skipped:
        say(f"sheet: {sheet}")
    return report


def _filmed(subject: Path, body: BodyModel, progress: Progress) -> list[Problem]:
    """Return what to film better, if stage 1 made the folder from a video and it is whole."""
    try:
        video = load_video(subject)
    except InputError:
        return []
    if video.kind != VIDEO_KIND or video.landmarks is None:
        return []
    record = Stage1Record.load(subject)
    return check_video(video, body, video.landmarks, record.fps, record.crowded, progress)


def refine(
    subjects: Path | str | Sequence[Path | str],
    options: RefineOptions = SequenceOptions(),  # noqa: B008 (frozen)
    *,
    normals: str | None = None,
    workers: int = 1,
    body: Path | str | None = None,
    overwrite: bool = False,
) -> list[MeasuredRefinement]:
    """Refine the poses of videos with their normals and masks: stage 2 of the paper, Eq. 8.

    Writes poses_refined.npz, uncertainty.npz, refinement.json and refinement.png into each
    subject's folder.

    Args:
        subjects: a folder with video, masks, cameras, stage-1 poses and perhaps normals; or several
            folders.
        options: their type chooses the method, as for :func:`gva_mi.refine.refine.refine`.
        normals: how the normals were made, by a name of :mod:`gva_mi.subject.normals`, or "none" to
            ignore them; without it, as the subject's normals.json says.
        workers: processes on this machine; any number gives the same bits.
        body: a body file; without it, the first subject's, else the built-in body.
        overwrite: replace existing refined poses.

    Returns:
        One evaluation per subject, in their order.

    Example:
        >>> refine([])
        Traceback (most recent call last):
        gva_mi.core.errors.InputError: refine: give the folder of a subject, or of several
    """
    folders = [subjects] if isinstance(subjects, Path | str) else subjects
    folders = [Path(folder) for folder in folders]
    if not folders:
        raise InputError("refine: give the folder of a subject, or of several")
    body = body_of(folders[0], body)
    for folder in folders:
        if (folder / REFINED_POSES).exists():  # a missing subject is named when it is opened
            require_room(folder / REFINED_POSES, overwrite)
    opened = [open_subject(folder, folder / POSES, body, normals) for folder in folders]
    videos, model = [subject.video for subject in opened], opened[0].model
    found = []
    with ExitStack() as held:
        for folder in folders:
            held.enter_context(folder_lock(folder, "gva-mi refine"))
            require_room(folder / REFINED_POSES, overwrite)
        progress = held.enter_context(bar("refine"))
        results = refine_all(videos, model, options, progress, workers)
        for video, refined in zip(videos, results, strict=True):
            measured = MeasuredRefinement.of(video, model, options, refined)
            write_refinement(measured)
            found.append(measured)
            for line in describe(measured):
                say(line)
    return found


def fit(
    subject: Path | str,
    out: Path | str,
    options: FitOptions = FitOptions(),  # noqa: B008 (frozen)
    *,
    poses: Path | str | None = None,
    body: Path | str | None = None,
    overwrite: bool = False,
    resume: bool = False,
) -> Avatar:
    """Fit an avatar to the training frames of a video: Eq. 9, densification, re-initialisation.

    Args:
        subject: a folder with video, masks, cameras and poses.
        out: the run's folder.
        options: of the fit.
        poses: the poses to fit under; without it, the refined poses, else the stage-1 poses.
        body: a body file; without it, the subject's, else the built-in body.
        overwrite: replace an existing run.
        resume: continue a run that was stopped, with its poses and its body.

    Example:
        >>> avatar = fit("me/subject", "me/run")  # doctest: +SKIP
    """
    subject, out = Path(subject), Path(out)
    if resume:
        opened = run_folder.open_fitted(out, subject, poses, body)
    else:
        opened = open_subject(subject, poses, body)
    video, model = opened.video, opened.model
    if video.absent:
        left_out = with_reasons(video.absent)
        say(f"{subject}: {len(video.absent)} of {len(video)} frames are left out: {left_out}")
    video.require_train_frames()
    with folder_lock(out, "gva-mi fit"):
        if not resume:
            run_folder.require_none_begun(out, overwrite)
            make_room(out, run_folder.OPTIONS, overwrite)
        require_writable(out)
        start = time.perf_counter()
        with bar("fit") as progress:
            avatar = fit_avatar(
                video, model, options, out, offsets=video.offsets_of(len(model.v_template)),
                sources=run_folder.sources_of(opened.poses, opened.body, subject), resume=resume,
                progress=progress,
            )  # fmt: skip
    say(f"{options.all_steps} steps in {time.perf_counter() - start:.0f} s")
    say(f"avatar: {out / run_folder.AVATAR}")
    return avatar


def evaluate(
    run: Path | str,
    subject: Path | str,
    *,
    title: str | None = None,
    poses: Path | str | None = None,
    body: Path | str | None = None,
    fit_poses: bool = False,
    few: int | None = None,
    page: bool = True,
    workers: int = 1,
) -> Metrics:
    """Measure an avatar on the splits of a subject; write metrics.json and report.html.

    Args:
        run: the folder of a finished fit.
        subject: the folder it was fitted to.
        title: the title of the report; without it, the subject's name.
        poses: the poses it was fitted under; without it, as the run's record says.
        body: a body file; without it, as the run's record says. Hands are measured if the body has
            hands.
        fit_poses: also measure test frames, and novel poses of the ground truth, after fitting
            poses to these same frames; reported in separate rows.
        few: measure at most so many test frames, or training frames if there are none of these;
            without it, all splits.
        page: write report.html.
        workers: processes that fit poses; any number gives the same bits.

    Example:
        >>> metrics = evaluate("me/run", "me/subject")  # doctest: +SKIP
    """
    run, subject = Path(run), Path(subject)
    avatar = Avatar.load(run / run_folder.AVATAR)
    opened = run_folder.open_fitted(run, subject, poses, body)
    video, model = opened.video, opened.model
    require_body_of(avatar, model, body_name(opened.body))
    video.require_train_frames()
    with folder_lock(run, "gva-mi evaluate"):
        require_room(run / run_folder.METRICS, overwrite=True)
        scorer = Scorer(find_weights())
        trained = run_folder.under_trained_poses(video, run)
        about = {"scorer": scorer, "fit_to_pictures": fit_poses, "few": few, "workers": workers}
        with bar("evaluate") as progress:
            metrics = measure_run(
                run, avatar, video, "full", model, opened.poses, progress, **about
            )
        report = run / run_folder.REPORT
        if page:
            write_report(report, run, avatar, trained, title or subject.resolve().name, model)
    for table in metrics.tables():
        for line in aligned([table.head, *table.rows]):
            say(line)
    if page:
        say(f"report: {report}")
    return metrics


def track(
    run: Path | str,
    subject: Path | str,
    options: PhotometricOptions = PhotometricOptions(),  # noqa: B008 (frozen)
    *,
    poses: Path | str | None = None,
    body: Path | str | None = None,
    overwrite: bool = False,
    workers: int = 1,
) -> Pose:
    """Fit the poses of a video to its pictures, seen through an avatar of the person.

    Writes poses_photometric.npz and photometric.json into the subject's folder. These poses have
    seen the test frames, so other steps use them only if they are given.

    Args:
        run: the folder of a finished fit, or an avatar.npz, of this or another video of the same
            person.
        subject: a folder with video, masks, cameras and poses.
        options: options of the fit.
        poses: the start; without it, the poses trained with the avatar, if ``run`` is a folder that
            was fitted to this video; else the refined poses, else the stage-1 poses.
        body: a body file; without it, the run's, else the built-in body.
        overwrite: replace existing poses.
        workers: processes on this machine; any number gives the same bits.

    Example:
        >>> poses = track("me/run", "me/subject")  # doctest: +SKIP
        >>> len(poses) == len(load_video(Path("me/subject")))  # doctest: +SKIP
        True
    """
    run, subject = Path(run), Path(subject)
    out = subject / TRACKED_POSES
    require_room(out, overwrite)
    avatar = run_folder.load_avatar(run)
    opened = open_subject(subject, poses, body or run_folder.source_of(run, "body", subject))
    video, model, start = opened.video, opened.model, opened.poses
    trained = None if poses is not None else run_folder.trained_poses(run)
    offsets = video.offsets_of(len(model.v_template))
    if trained is not None:
        if others := run_folder.other_pictures(run, video):
            say(f"{run}: was fitted to another video (other {others}); its poses are not used")
        else:
            start, video = trained, load_video(subject, trained)
    with folder_lock(subject, "gva-mi track"):
        require_room(out, overwrite)
        pays = len(video) * options.passes >= SHARED_LOSSES
        with bar("track") as progress, helper_processes(workers, pays) as helpers:
            found = fit_poses(avatar, video, options, None, progress, helpers)
        write_tracking(video, found, options, offsets, {"start": start, "avatar": run})
    for line in kept_poses(video, found.kept, "pose"):
        say(line)
    say(f"loss {found.losses_before.nanmean():.4f} → {found.losses.nanmean():.4f}")
    say(f"poses: {out}")
    return found.pose
