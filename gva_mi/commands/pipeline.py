"""The steps of the study. Each reads a folder, writes a folder, and can be run alone.

::

    synth ──▶ subject/ ──▶ refine ──▶ subject/poses_refined.npz ──▶ fit ──▶ run/ ──▶ evaluate
                                                                            ├──────▶ render
                                                                            └──────▶ track

``demo`` runs them all but ``track``. No output is replaced unless asked for.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from torch import Tensor
from tyro.conf import Positional, arg

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import load_offsets, load_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.console import bar, say
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.pictures import read_image, write_image, write_movie
from gva_mi.data.synthetic import SynthOptions, describe_noise, make_subject
from gva_mi.data.synthetic.contact_sheet import contact_sheet as draw_sheet
from gva_mi.data.video import Video, load_cameras, load_video
from gva_mi.errors import InputError
from gva_mi.files import write_json
from gva_mi.fit import checkpoint
from gva_mi.fit.evaluate import evaluate as evaluate_splits
from gva_mi.fit.evaluate import render_sequence
from gva_mi.fit.options import FitOptions, Rates
from gva_mi.fit.photometric import FITTED, PhotometricOptions
from gva_mi.fit.photometric import fit_poses as fit_to_pictures
from gva_mi.fit.report import write_report
from gva_mi.fit.train import fit as fit_avatar
from gva_mi.fit.views import overview
from gva_mi.pose.evaluation.ablation import ablate
from gva_mi.pose.evaluation.measure import Measured, measure_frames
from gva_mi.pose.evaluation.record import OVERLAYS, REFINED, REFINEMENT, write_record
from gva_mi.pose.evaluation.report import write_report as write_refinement_report
from gva_mi.pose.parallel import cluster as _cluster
from gva_mi.pose.parallel import workers as _workers
from gva_mi.pose.refine import RefineOptions, refine_all

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line

POSES, REFINEMENT_REPORT = "poses.npz", "refinement.html"
METRICS, REPORT, OVERVIEW = "metrics.json", "report.html", "overview.png"
SUBJECT = "subject"  # where the demo's subject lies within the demo's folder
DEMO, RENDERED, SYNTH = "demo.json", "render.json", "synth.json"  # mark the folders as ours
REFINEMENT_FIGURES = (  # of metrics.json
    "vertex_mm_stage1", "vertex_mm", "hand_vertex_mm_stage1", "hand_vertex_mm",
    "foot_vertex_mm_stage1", "foot_vertex_mm", "aligned_vertex_mm_stage1", "aligned_vertex_mm",
    "frames_worse", "frames_worse_hands", "iou_stage1", "iou", "iou_truth", "seconds_per_frame",
)  # fmt: skip


@dataclass(frozen=True)
class DemoOptions:
    """How large the demo is; the defaults end within 8 minutes on 2 cores."""

    seed: int = 0  # of the subject, the refinement and the fit
    subject: str = "amira"  # one of the study's seven
    frames: int = 64  # of the video
    size: int = 400  # pixels, width and height
    steps: int = 2000  # of the fit
    no_refine: bool = False  # stage-1 poses as they are, to see what refining them is worth


def synth(
    out: Positional[Path | None] = None,
    options: Flat[SynthOptions] = SynthOptions(),  # noqa: B008 (frozen)
    *,
    sheet: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras, noisy poses, and the truth apart.

    Args:
        out: the subject's folder.
        options: what it is like.
        sheet: write a picture (.png) of the study's seven subjects, and of what comes with a video.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace a subject that is there.
    """
    if out is None and sheet is None:
        raise InputError("synth: give a folder for a subject, or --sheet FILE.png, or both")
    model = load_body(body)
    if sheet is not None:
        with bar("sheet") as progress:
            draw_sheet(sheet, model, progress=progress)
        say(f"sheet: {sheet}")
    if out is None:
        return
    _clear(out, SYNTH, overwrite)
    with bar("synth") as progress:
        make_subject(out, options, model, progress)
    for line in describe_noise(out):
        say(line)
    say(f"subject: {out}")


def refine(
    subjects: Positional[tuple[Path, ...]],
    options: Flat[RefineOptions],
    *,
    normals: Literal["perspective", "icon", "none"] | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    report: bool = False,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Refine the poses of videos with their normals and masks: stage 2 of the paper, Eq. 9.

    Writes poses_refined.npz, refinement.json and refinement.png into each subject's folder.

    Args:
        subjects: folders with video, masks, cameras, stage-1 poses; normals where there are some.
        options: of the refinement.
        normals: how the normals were made: as the video's camera sees them, or as ICON writes them
            (orthographic, y up); none: they are not used. Without it as normals.json says.
        workers: processes on this machine; any number gives the same bits.
        scheduler: address of a dask.distributed cluster that does the work instead.
        report: also write refinement.html, for which all terms of the loss are left out in turn.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace refined poses that are there.
    """
    if not subjects:
        raise InputError("refine: give the folder of a subject, or of several")
    if scheduler is not None and workers != 1:
        raise InputError("refine: give --workers or --scheduler, not both")
    model = load_body(body)
    for subject in subjects:
        if (subject / REFINED).exists() and not overwrite:
            raise InputError(f"{subject / REFINED}: exists already; give --overwrite to replace it")
        require_same_body(subject, model)
    with _cluster(scheduler) if scheduler is not None else _workers(workers) as executor:
        videos = [load_video(subject, normals=normals) for subject in subjects]
        for video, measured in _refine(videos, model, options, report, executor):
            for line in _refinement_lines(measured.means.as_record()):
                say(line)
            say(f"poses: {video.folder / REFINED}; overlays: {video.folder / OVERLAYS}")
            if report:
                say(f"report: {video.folder / REFINEMENT_REPORT}")


def fit(
    subject: Positional[Path],
    options: Flat[FitOptions],
    *,
    out: Path,
    poses: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
) -> None:
    """Fit an avatar to the training frames of a video: Eq. 13, densification, re-initialisation.

    Args:
        subject: a folder with video, masks, cameras and poses.
        options: of the fit.
        out: the run's folder.
        poses: the poses to fit under; without it the refined ones, else those of stage 1.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace a run that is there.
        resume: go on with a run that was stopped.
    """
    model = load_body(body)
    require_same_body(subject, model)
    poses = poses or best_poses(subject)
    video = load_video(subject, poses)
    for frame, reason in video.absent.items():
        say(f"{subject}: frame {frame} is left out: {reason}")
    if not resume:
        _clear(out, checkpoint.OPTIONS, overwrite)
    _fit(video, model, options, out, load_offsets(poses, len(model.v_template)), resume)
    say(f"avatar: {out / checkpoint.AVATAR}")


def evaluate(
    run: Positional[Path],
    subject: Positional[Path],
    *,
    poses: Path | None = None,
    fit_poses: bool = False,
) -> None:
    """Measure an avatar on the splits of a subject; writes metrics.json and report.html.

    Args:
        run: the folder of a finished fit.
        subject: the folder it was fitted to.
        poses: the poses it was fitted under; without it the refined ones, else those of stage 1.
        fit_poses: also measure the test frames, in a row of its own, with their poses fitted to
            these very frames.
    """
    avatar = Avatar.load(run / checkpoint.AVATAR)
    video = load_video(subject, poses or best_poses(subject))
    metrics = _measure(avatar, video, run, name="full", fitted=fit_poses)
    _write_report(avatar, _under_trained_poses(video, run), run, metrics, subject.name)
    for line in _lines(metrics):
        say(line)
    say(f"report: {run / REPORT}")


def render(
    run: Positional[Path],
    *,
    poses: Path,
    cameras: Path,
    out: Path,
    video: bool = False,
    overwrite: bool = False,
) -> None:
    """Drive an avatar by any poses, seen by any cameras: pictures, or a film.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        poses: SMPL-X's names, each (T, ...).
        cameras: K, T_camera_world, width, height; one for all frames, or T.
        out: folder for 000000.png ...
        video: also write video.mp4 there.
        overwrite: replace renders that are there.
    """
    avatar = Avatar.load(run / checkpoint.AVATAR if run.is_dir() else run)
    pose, _ = load_poses(poses)
    views = load_cameras(cameras)
    if len(views) not in (1, len(pose)):
        raise InputError(
            f"{cameras}: holds {len(views)} cameras, expected one, or one for each of the "
            f"{len(pose)} frames of {poses}"
        )
    _clear(out, RENDERED, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    (out / RENDERED).write_text(json.dumps({"avatar": str(run), "versions": checkpoint.versions()}))
    images = []
    with bar("render") as progress:
        for k, image in enumerate(render_sequence(avatar, pose, views)):
            write_image(out / f"{k:06d}.png", image)
            images += [image] if video else []
            progress(k + 1, len(pose))
    if video:
        write_movie(out / "video.mp4", images, lossless=False)
    say(f"{len(pose)} pictures: {out}")


def demo(
    options: Flat[DemoOptions], *, out: Path, body: Path | None = None, overwrite: bool = False
) -> None:
    """All of it on a synthetic subject: synth, refine, fit, evaluate, report.

    Args:
        options: how large it is.
        out: folder for the subject, the run and the report.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace a demo that is there.
    """
    start = time.perf_counter()
    model = load_body(body)
    # All options first: a bad one is refused before anything is written or replaced.
    synth_options = SynthOptions(
        seed=options.seed, subject=options.subject, frames=options.frames, size=options.size
    )
    rates = Rates(pose=0.0) if options.no_refine else Rates()
    fit_options = FitOptions(seed=options.seed, steps=options.steps, rates=rates)
    _clear(out, DEMO, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / DEMO, {"options": asdict(options), "versions": checkpoint.versions()})
    subject = out / SUBJECT
    with bar("synth") as progress:
        make_subject(subject, synth_options, model, progress)
    if not options.no_refine:
        list(_refine([load_video(subject)], model, RefineOptions(seed=options.seed)))
    poses = best_poses(subject)
    video = load_video(subject, poses)
    offsets = load_offsets(poses, len(model.v_template))
    avatar = _fit(video, model, fit_options, out, offsets, resume=False)
    metrics = _measure(avatar, video, out, name="no_refine" if options.no_refine else "full")
    _write_report(avatar, _under_trained_poses(video, out), out, metrics, "The demo subject")
    for line in _lines(metrics):
        say(line)
    say(f"{(time.perf_counter() - start) / 60:.1f} minutes; report: {out / REPORT}")


def _refine(
    videos: Sequence[Video],
    model: BodyModel,
    options: RefineOptions,
    report: bool = False,
    executor: Executor | None = None,
) -> Iterator[tuple[Video, Measured]]:
    """Refine, and write what was found into each subject's folder."""
    for video in videos:
        if not video.has_normals:
            say(f"{video.folder}: no normals, the refinement uses the silhouettes alone")
    with bar("refine") as progress:
        found = refine_all([(video, options) for video in videos], model, progress, executor)
        for video, refined in zip(videos, found, strict=True):
            for frame, reason in refined.kept.items():
                say(f"{video.folder}: frame {frame} keeps its stage-1 pose: {reason}")
            truth = load_poses(video.truth / POSES) if video.truth else None
            measured = measure_frames(video, model, refined, truth)
            write_record(video, model, refined, measured, options, checkpoint.versions())
            if report:
                with bar("ablation") as ablating:
                    ablation = ablate(video, model, options, measured, truth, ablating, executor)
                write_refinement_report(
                    video.folder / REFINEMENT_REPORT,
                    title=f"Poses of {video.folder.name}",
                    video=video,
                    body=model,
                    refined=refined,
                    measured=measured,
                    options=options,
                    versions=checkpoint.versions(),
                    truth=truth,
                    ablation=ablation,
                )
            yield video, measured


def _fit(
    video: Video,
    model: BodyModel,
    options: FitOptions,
    out: Path,
    offsets: Tensor | None,
    resume: bool,
) -> Avatar:
    start = time.perf_counter()
    with bar("fit") as progress:
        avatar = fit_avatar(
            video, model, options, out, offsets=offsets, resume=resume, progress=progress
        )
    say(f"{options.steps} steps in {time.perf_counter() - start:.0f} s")
    return avatar


def _measure(avatar: Avatar, video: Video, run: Path, name: str, fitted: bool = False) -> dict:
    """The figures of a run, which are also written to ``metrics.json``."""
    under = _under_trained_poses(video, run)
    with bar("evaluate") as progress:
        rows = evaluate_splits(avatar, under, name, progress=progress)
    if (run / checkpoint.POSES).exists():  # what training the poses is worth to frames unseen
        rows += evaluate_splits(avatar, video, "poses as refined", splits=("test",))
    pose_fit = {}
    if fitted:
        with bar("poses") as progress:
            options = PhotometricOptions()
            found = fit_to_pictures(avatar, under, options, under.splits.test, progress)
        seen = replace(under, pose=found.pose)
        rows += evaluate_splits(avatar, seen, FITTED, splits=("test",))
        pose_fit = {
            "pose_fit": {
                "options": asdict(options),
                "kept": found.kept,
                "seconds_per_frame": found.seconds_per_frame,
            }
        }
    history = checkpoint.load_history(run)
    record = json.loads((run / checkpoint.OPTIONS).read_text())
    refinement = video.folder / REFINEMENT
    found = json.loads(refinement.read_text())["figures"] if refinement.exists() else {}
    metrics = {
        "rows": [asdict(row) for row in rows],
        "refinement": {name: found.get(name) for name in REFINEMENT_FIGURES},
        "training": {
            "steps": len(history["loss"]),
            "seconds": float(history["milliseconds"].sum() / 1e3),
            "gaussians": int(history["gaussians"][-1]),
            "size": list(video.size),
        },
        "options": record["options"],
        "versions": record["versions"],
        "seed": record["options"]["seed"],
        **pose_fit,
    }
    write_json(run / METRICS, metrics)
    return metrics


def _write_report(avatar: Avatar, video: Video, run: Path, metrics: dict, title: str) -> None:
    overlays = video.folder / OVERLAYS
    write_image(run / OVERVIEW, overview(avatar, video))
    write_report(
        run / REPORT,
        title=title,
        metrics=metrics,
        history=checkpoint.load_history(run),
        avatar=avatar,
        video=video,
        overlays=[read_image(overlays, 3)] if overlays.exists() else [],
        snapshots=list(checkpoint.load_snapshots(run)),
    )


def _under_trained_poses(video: Video, run: Path) -> Video:
    """The video under the poses that were trained with the avatar, where they were."""
    poses = run / checkpoint.POSES
    return replace(video, pose=load_poses(poses)[0]) if poses.exists() else video


def best_poses(subject: Path) -> Path:
    """The refined poses of a subject; where it has none, those of stage 1, which is said."""
    refined = subject / REFINED
    if refined.exists():
        return refined
    say(f"{subject}: no {REFINED}, the stage-1 poses are used as they are")
    return subject / POSES


def _lines(metrics: dict) -> Iterator[str]:
    """The main figures, a line each."""
    yield from _refinement_lines(metrics["refinement"])
    for row in metrics["rows"]:
        split = row["split"].replace("_", " ")
        name = "" if row["name"] == metrics["rows"][0]["name"] else f" ({row['name']})"
        yield f"{split:<11} PSNR {row['psnr']:.2f} dB, SSIM {row['ssim']:.4f}{name}"


def _refinement_lines(figures: dict) -> Iterator[str]:
    pairs = {"vertices": "vertex_mm", "hands": "hand_vertex_mm", "feet": "foot_vertex_mm"}
    pairs["aligned"] = "aligned_vertex_mm"  # the vertices, with the pelvis put where it is
    for name, key in pairs.items():
        if figures[key] is not None:
            yield f"{name:<11} {figures[key + '_stage1']:.1f} → {figures[key]:.1f} mm"
    if figures["frames_worse"] is not None:
        worse = f"{figures['frames_worse']:.0%} of the frames"
        yield f"worse       {worse}, in the hands {figures['frames_worse_hands']:.0%}"
    if figures["iou"] is not None:
        truth = figures["iou_truth"]
        own = f" (true pose {truth:.3f})" if truth is not None else ""
        yield f"silhouette  IoU {figures['iou_stage1']:.3f} → {figures['iou']:.3f}{own}"


def _clear(out: Path, marker: str, overwrite: bool) -> None:
    """Make room for an output folder, but never at the cost of anything that is not ours."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not overwrite:
        raise InputError(f"{out}: already holds something; give --overwrite to replace it")
    if not (out / marker).exists():
        raise InputError(
            f"{out}: has no {marker}, so gva-mi did not make it and will not replace it"
        )
    shutil.rmtree(out)
