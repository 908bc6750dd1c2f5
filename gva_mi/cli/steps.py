"""The commands of single steps: check, refine, fit, evaluate, score, track, render."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gva_mi import app
from gva_mi.app.scenes import SceneOptions
from gva_mi.body.smplx import load_body
from gva_mi.cli.parse import Flat, Switch
from gva_mi.core.console import aligned, bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room, write_json
from gva_mi.core.options import Within, Workers
from gva_mi.core.tasks import usual_workers
from gva_mi.evaluate.figures import pivot, table, to_json
from gva_mi.evaluate.scores import Scorer, pairs_of_pictures, pairs_of_subject, score_pictures
from gva_mi.fit import paper
from gva_mi.fit.options import FitOptions
from gva_mi.fit.perceptual import find_weights
from gva_mi.fit.photometric import PhotometricOptions
from gva_mi.fit.renders import CameraPath
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.subject.folder import CAMERAS
from gva_mi.subject.opened import body_of
from gva_mi.subject.pictures import read_background, require_picture
from gva_mi.subject.video import load_video

ERRORS_FOUND = 1  # exit code of a check


def check(
    subject: Positional[Path],
    *,
    body: Path | None = None,
    sheet: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Find everything that is wrong with a subject's folder, in one pass.

    The exit code 0 means no error, 1 at least one, and 2 that the folder cannot be read.

    Args:
        subject: the folder.
        body: the body file of its poses, in SMPL-X's format; without it, the body that it was
            prepared for, else the built-in body.
        sheet: also write a picture (.png) of a few frames with the outlines of mask and body.
        overwrite: replace this picture.
    """
    if sheet is not None:
        require_picture(sheet, overwrite)
    report = app.check(subject, body=body, sheet=sheet)
    if report.errors:
        sys.exit(ERRORS_FOUND)


def refine(
    subjects: Positional[tuple[Path, ...]],
    options: Flat[SequenceOptions] = SequenceOptions(),  # noqa: B008 (frozen)
    *,
    preset: Literal["default", "paper"] = "default",
    normals: Literal["perspective", "opengl", "icon", "none"] | None = None,
    workers: Workers = 1,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Refine the poses of videos with their normals and masks: stage 2 of the paper, Eq. 8.

    Writes poses_refined.npz, uncertainty.npz, refinement.json and refinement.png into each
    subject's folder.

    Args:
        subjects: folders with video, masks, cameras, stage-1 poses, and perhaps normals.
        options: options of the refinement.
        preset: paper: Eq. 8 as printed, frame by frame. It uses only the options size and passes
            (80 by default).
        normals: how the normals were made: as the video's camera sees them, or as ICON writes them
            (orthographic, y up); none: ignore them. Without it, as normals.json says.
        workers: processes on this machine; any number gives the same bits.
        body: a body file in SMPL-X's format (.npz); without it, the body that the first subject was
            prepared for, else the built-in body.
        overwrite: replace existing refined poses.
    """
    if preset == "paper":
        for name, given in (("height", options.height), ("hold-out-test", options.hold_out_test)):
            if given:
                raise InputError(
                    f"refine: --{name} is an option of the refinement of all frames together; "
                    "--preset paper is Eq. 8 as printed, frame by frame"
                )
        options = replace(paper.REFINE, size=options.size, passes=options.passes)
    app.refine(subjects, options, normals=normals, workers=workers, body=body, overwrite=overwrite)


refine.presets = {"paper": SequenceOptions(passes=paper.REFINE.passes)}


def fit(
    subject: Positional[Path],
    options: Flat[FitOptions] = FitOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    preset: Literal["default", "paper", "video"] = "default",
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
        preset: paper: all options as the paper prints them; video: the options of `gva-mi avatar`.
            Explicit options override it.
        poses: the poses to fit under; without it, the refined poses, else the stage-1 poses.
        body: a body file in SMPL-X's format (.npz); without it, the body that the subject was
            prepared for, else the built-in body.
        overwrite: replace an existing run.
        resume: continue a run that was stopped, with its poses and its body.
    """
    app.fit(subject, out, options, poses=poses, body=body, overwrite=overwrite, resume=resume)


fit.presets = {"paper": paper.FIT, "video": app.AvatarEffort().fitting()}


def evaluate(
    run: Positional[Path],
    subject: Positional[Path],
    *,
    poses: Path | None = None,
    body: Path | None = None,
    fit_poses: Switch = False,
) -> None:
    """Measure an avatar on the splits of a subject; write metrics.json and report.html.

    Args:
        run: the folder of a finished fit.
        subject: the folder it was fitted to.
        poses: the poses it was fitted under; without it, as the run's record says.
        body: the body file that it was fitted with, in SMPL-X's format (.npz); without it, as the
            run's record says. Hands are measured if the body has hands.
        fit_poses: also measure test frames, and novel poses of the ground truth, after fitting
            poses to these same frames; reported in separate rows.
    """
    workers = usual_workers()
    app.evaluate(run, subject, poses=poses, body=body, fit_poses=fit_poses, workers=workers)


def score(
    renders: Positional[Path],
    truth: Positional[Path],
    *,
    masks: Path | None = None,
    background: str = "white",
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Score renders of any method: whole picture, box, mask, hands, face.

    Pictures are paired by the last number in their file names, frames of videos by their order.

    Args:
        renders: a video or a folder of pictures; pictures with alpha are put on the background.
        truth: a video or a folder of pictures, or a subject's folder, whose masks and poses give
            box, mask, hands and face.
        masks: masks of the person in the pictures of truth: a video, a folder, or a .npy (T, H, W).
        background: the colour behind the renders, on which masked pictures are put; none: pictures
            stay as they are.
        out: also write the table to this .json file.
        overwrite: replace that file.
    """
    if out is not None:
        require_room(out, overwrite)
    color = None if background == "none" else read_background(background, 1, 1).reshape(-1)[:3]
    if not (truth / CAMERAS).is_file():  # not a subject's folder
        pairs = pairs_of_pictures(renders, truth, masks, color)
    elif masks is None:
        pairs = pairs_of_subject(renders, load_video(truth), load_body(body_of(truth)), color)
    else:
        raise InputError(f"{truth}: has its own masks; give it without --masks")
    scorer = Scorer(find_weights())
    with bar("score") as progress:
        figures = score_pictures(pairs, scorer, progress)
    found = table(pivot(figures, ("region",)))
    for line in aligned([found.head, *found.rows]):
        say(line)
    if out is not None:
        record = {"background": background, "figures": to_json(figures)}
        write_json(out, record | {"networks": scorer.networks()})
        say(f"figures: {out}")


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
        run: the folder of a finished fit, or an avatar.npz, of this or another video of the same
            person.
        subject: a folder with video, masks, cameras and poses.
        options: options of the fit.
        poses: the start; without it, the poses trained with the avatar, if RUN is a folder that was
            fitted to this video; else the refined poses, else the stage-1 poses.
        body: a body file in SMPL-X's format (.npz); without it, the body of the run, or of the
            subject, else the built-in body.
        overwrite: replace existing poses.
    """
    about = {"poses": poses, "body": body, "overwrite": overwrite, "workers": usual_workers()}
    app.track(run, subject, options, **about)


def render(
    run: Positional[Path],
    path: Flat[CameraPath] = CameraPath(),  # noqa: B008 (frozen)
    scene: Flat[SceneOptions] = SceneOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    poses: Path | None = None,
    cameras: Path | None = None,
    background: str = "white",
    alpha: Switch = False,
    video: Switch = False,
    fps: Annotated[int, Within(1, 1000)] = 25,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Drive an avatar by any poses, seen by any cameras: pictures, or a video.

    If it was interrupted, the same command resumes it.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        path: where the cameras stand, if --cameras is not given.
        scene: a Mitsuba scene around the person.
        out: folder for the pictures 000000.png, 000001.png ...
        poses: poses under SMPL-X's names, each (T, ...), or any motion that gva-mi motion reads;
            without it, the poses trained with the avatar.
        cameras: a file with K, T_camera_world, width, height; one for all frames, or T.
        background: a colour, such as white or #ff8800, or a picture file.
        alpha: make the pictures transparent around the avatar.
        video: also write video.mp4 there; not with --alpha.
        fps: frames per second of videos; motions of other programs are resampled to it.
        body: the body file of an avatar without its body; without it, the run's, else the built-in.
        overwrite: replace existing renders.
    """
    app.render(
        run, out, path, poses=poses, cameras=cameras, background=background, alpha=alpha,
        video=video, fps=fps, scene=scene, body=body, overwrite=overwrite,
    )  # fmt: skip
