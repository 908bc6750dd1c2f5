"""The command ``gva-mi fit``: fit an avatar to a video."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.cli.arguments import Flat, Switch, body_of, poses_of, warn_if_outside_masks
from gva_mi.cli.presets import FitPreset
from gva_mi.core.atomic import folder_lock, require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.files import make_room
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.video import Video, load_video
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions
from gva_mi.fit.train import fit as fit_avatar


def fit(
    subject: Positional[Path],
    options: Flat[FitOptions],
    *,
    out: Path,
    preset: FitPreset = "default",
    poses: Path | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
    resume: Switch = False,
) -> None:
    """Fit an avatar to the training frames of a video: Eq. 9, densification, re-initialisation.

    Args:
        subject: a folder with video, masks, cameras and poses.
        options: options of the fit.
        out: the run's folder.
        preset: paper: all options as the paper prints them; film: those of `gva-mi avatar`.
            Options beside it win.
        poses: the poses to fit under; without it the refined ones, else those of stage 1.
        body: a body in SMPL-X's .npz format; without it the one the subject was prepared for, else
            the built-in body.
        overwrite: replace a run that is there.
        resume: continue a run that was stopped, with its poses and its body.
    """
    if resume:
        body = body or run_folder.source_of(out, "body", subject)
        poses = poses or run_folder.source_of(out, "poses", subject)
    body = body_of(subject, body)
    model = load_body(body)
    require_same_body(subject, model)
    poses = poses_of(subject, poses)
    video = load_video(subject, poses)
    for frame, reason in video.absent.items():
        say(f"{subject}: frame {frame} is left out: {reason}")
    video.require_train_frames()
    warn_if_outside_masks(video, model)
    with folder_lock(out, "gva-mi fit"):
        if not resume:
            run_folder.require_none_begun(out, overwrite)
            make_room(out, run_folder.OPTIONS, overwrite)
        require_writable(out)
        sources = run_folder.sources_of(poses, body, subject)
        fit_video(video, model, options, out, resume, sources)
    say(f"avatar: {out / run_folder.AVATAR}")


def fit_video(
    video: Video,
    model: BodyModel,
    options: FitOptions,
    out: Path,
    resume: bool = False,
    sources: Mapping[str, str | None] | None = None,
) -> Avatar:
    """Fit an avatar with the video's poses and surface offsets, and print how long it took."""
    offsets = video.offsets_of(len(model.v_template))
    start = time.perf_counter()
    with bar("fit") as progress:
        avatar = fit_avatar(
            video,
            model,
            options,
            out,
            offsets=offsets,
            sources=sources,
            resume=resume,
            progress=progress,
        )
    say(f"{options.all_steps} steps in {time.perf_counter() - start:.0f} s")
    return avatar
