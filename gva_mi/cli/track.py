"""The command ``gva-mi track``: fit a video's poses to its pictures through an avatar."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Flat, Switch, body_of, poses_of, warn_if_outside_masks
from gva_mi.core.atomic import folder_lock
from gva_mi.core.console import bar, say
from gva_mi.core.files import require_room
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.video import load_video
from gva_mi.fit.photometric import (
    TRACKED_POSES,
    PhotometricOptions,
    fit_poses,
    known_poses,
    lines_of,
    measure_tracking,
    write_tracking,
)
from gva_mi.fit.run_folder import TRAINED_POSES, load_avatar, other_pictures, source_of


def track(
    run: Positional[Path],
    subject: Positional[Path],
    options: Flat[PhotometricOptions] = PhotometricOptions(),  # noqa: B008 (frozen)
    *,
    poses: Path | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Fit the poses of a video to its pictures, seen through an avatar of the person.

    Writes poses_photometric.npz and photometric.json into the subject's folder. These poses have
    seen the test frames, so other steps use them only if --poses names them.

    Args:
        run: the folder of a finished fit, or an avatar.npz, of this video or of another one of the
            same person.
        subject: a folder with video, masks, cameras and poses.
        options: options of the fit.
        poses: the start; without it the poses trained with the avatar, if ``run`` is a folder that
            was fitted to this video; else the refined ones, else those of stage 1.
        body: a body in SMPL-X's .npz format; without it the one of the run, or of the subject,
            else the built-in body.
        overwrite: replace existing poses.
    """
    out = subject / TRACKED_POSES
    require_room(out, overwrite)
    avatar = load_avatar(run)
    model = load_body(body or source_of(run, "body", subject) or body_of(subject))
    require_same_body(subject, model)
    refined = poses_of(subject, poses)
    video, start = load_video(subject, refined), refined
    offsets = video.offsets_of(len(model.v_template))
    if poses is None and (trained := run / TRAINED_POSES).exists():
        if others := other_pictures(run, video):
            say(f"{run}: was fitted to another video (other {others}); its poses are not used")
        else:
            video, start = load_video(subject, trained), trained
    warn_if_outside_masks(video, model)
    known = known_poses(video, model)
    with folder_lock(subject, "gva-mi track"):
        require_room(out, overwrite)
        with bar("track") as progress:
            found = fit_poses(avatar, video, options, progress=progress)
        for frame, reason in found.kept.items():
            say(f"{subject}: frame {frame} keeps its pose: {reason}")
        tracking = measure_tracking(video, model, found, known)
        sources = {"start": start, "avatar": run}
        write_tracking(video, found, tracking, options, offsets, sources)
    for line in lines_of(tracking):
        say(line)
    say(f"poses: {out}")
