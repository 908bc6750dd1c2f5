"""The photometric pass as a step: a video's poses, fitted to its pictures through an avatar."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape, load_offsets, load_poses, save_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.commands.pipeline import POSES, Flat, best_poses
from gva_mi.console import bar, say
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.video import Video, load_video
from gva_mi.errors import InputError
from gva_mi.files import write_json
from gva_mi.fit import checkpoint
from gva_mi.fit.photometric import PhotometricOptions, fit_poses
from gva_mi.pose.evaluation.measure import vertex_errors

PHOTOMETRIC, TRACKING = "poses_photometric.npz", "photometric.json"  # what is written
PARTS = {"vertices": "body", "hands": "hands", "feet": "feet", "aligned": "body_aligned"}


def track(
    run: Positional[Path],
    subject: Positional[Path],
    options: Flat[PhotometricOptions] = PhotometricOptions(),  # noqa: B008 (frozen)
    *,
    poses: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Fit the poses of a video to its pictures, seen through an avatar of the person.

    Writes poses_photometric.npz and photometric.json into the subject's folder. They have seen the
    test frames: no other step takes them but by its --poses.

    Args:
        run: the folder of a finished fit, or an avatar.npz, of this video or of another one of the
            same person.
        subject: a folder with video, masks, cameras and poses.
        options: of the fit.
        poses: where it starts; without it the poses trained with the avatar, if ``run`` is a folder
            that has some; else the refined ones, else those of stage 1.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: replace poses that are there.
    """
    if (subject / PHOTOMETRIC).exists() and not overwrite:
        raise InputError(f"{subject / PHOTOMETRIC}: exists already; give --overwrite to replace it")
    avatar = Avatar.load(run / checkpoint.AVATAR if run.is_dir() else run)
    model = load_body(body)
    require_same_body(subject, model)
    trained = run / checkpoint.POSES
    refined = poses or best_poses(subject)
    start = trained if poses is None and trained.exists() else refined
    video = load_video(subject, start)
    with bar("track") as progress:
        found = fit_poses(avatar, video, options, progress=progress)
    for frame, reason in found.kept.items():
        say(f"{subject}: frame {frame} keeps its pose: {reason}")
    figures = {
        "loss_start": float(found.losses_before.nanmean()),
        "loss": float(found.losses.nanmean()),
        "seconds_per_frame": found.seconds_per_frame,
    }
    stages = {
        "stage 1": load_poses(subject / POSES),
        "start": (video.pose, video.shape),
        "tracked": (found.pose, video.shape),
    }
    errors = _errors(video, model, stages)
    record = {
        "figures": figures,
        "errors_mm": errors,
        "kept": found.kept,
        "start": str(start),
        "avatar": str(run),
        "options": asdict(options),
        "versions": checkpoint.versions(),
    }
    write_json(subject / TRACKING, record)
    offsets = load_offsets(refined, len(model.v_template))
    save_poses(subject / PHOTOMETRIC, found.pose, video.shape, stage=2, offsets=offsets)
    for name, part in PARTS.items() if errors else ():
        lengths = (f"{stage} {of_stage[part]:.1f}" for stage, of_stage in errors.items())
        say(f"{name:<11} {' → '.join(lengths)} mm")
    say(f"loss        {figures['loss_start']:.4f} → {figures['loss']:.4f}")
    say(f"poses: {subject / PHOTOMETRIC}")


def _errors(
    video: Video, model: BodyModel, stages: dict[str, tuple[Pose, Shape]]
) -> dict[str, dict[str, float]]:
    """Mean distances to the truth by stage and part of the body, mm; empty without a truth."""
    if video.truth is None:
        return {}
    truth = load_poses(video.truth / POSES)
    found = {stage: asdict(vertex_errors(model, poses, truth)) for stage, poses in stages.items()}
    return {
        stage: {part: float(of_frames.mean()) for part, of_frames in parts.items()}
        for stage, parts in found.items()
    }
