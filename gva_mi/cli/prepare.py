"""The commands ``prepare`` and ``motion``: a subject or a motion from a video or other files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gva_mi import app
from gva_mi.body.pose import save_poses
from gva_mi.cli.parse import Flat, Switch, given, nth_person
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_replaceable, require_room
from gva_mi.readers.datasets import DATASETS
from gva_mi.readers.estimators import KINDS
from gva_mi.readers.motions import Motion, MotionOptions, motion_of_poses, read_motion
from gva_mi.readers.prepare import PrepareOptions, prepare_folder
from gva_mi.readers.target_body import TargetBody
from gva_mi.stage1.prepare import PrepareVideoOptions, VideoSource, motion_of_video
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.folder import PREPARED

VIDEO_FILES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".gif")
VIDEO_OPTIONS = ("body", "person", "lens", "masks")  # fields of PrepareOptions that fit a video
_HELP = (
    f"{VIDEO_KIND}: everything is estimated here; or an estimator: {', '.join(KINDS)}; "
    f"or a data set: {', '.join(DATASETS)}; "
    'or "auto", which recognises estimator or data set by keys and files'
)


def prepare(
    kind: Annotated[Positional[str], arg(help=_HELP)],
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[PrepareOptions] = PrepareOptions(),  # noqa: B008 (frozen)
    video_options: Flat[PrepareVideoOptions] = PrepareVideoOptions(),  # noqa: B008 (frozen)
    *,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder from a video, from an estimator's poses, or from a data set.

    Args:
        kind: kind of the source.
        source: the video, or a folder of its pictures; the estimator's file or folder; or the data
            set's folder of one subject. Pickles are read without running their code.
        out: the subject's folder.
        options: pictures, masks, lens and body that belong to the source.
        video_options: what is known about a video.
        overwrite: replace a folder that was prepared here.
    """
    if kind not in ("auto", VIDEO_KIND) and kind not in (kinds := {**KINDS, **DATASETS}):
        raise InputError(
            f"prepare: kind must be auto, {VIDEO_KIND}, {', '.join(kinds)}; got {kind}"
        )
    if kind == VIDEO_KIND:
        wrong = [option for name, option in given(options).items() if name not in VIDEO_OPTIONS]
        if wrong:
            raise InputError(f"prepare: {wrong[0]} is not for a {VIDEO_KIND}")
        app.prepare(
            source, out, video_options, options, person=nth_person(options.person),
            lens=options.lens, body=options.body, overwrite=overwrite,
        )  # fmt: skip
        return
    if wrong := given(video_options):
        raise InputError(f"prepare: {next(iter(wrong.values()))} is for a {VIDEO_KIND}; got {kind}")
    if options.body is None:
        raise InputError("prepare: give --body, the body of the poses: a body file, or built-in")
    body = TargetBody.read(options.body)
    require_replaceable(out, PREPARED, overwrite)
    with atomic_dir(out, PREPARED if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, kind, source, options, body, progress)
    for note in notes:
        say(f"{source}: {note}")
    say(f"subject: {out}")


def motion(
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[MotionOptions] = MotionOptions(),  # noqa: B008 (frozen)
    video_options: Flat[VideoSource] = VideoSource(),  # noqa: B008 (frozen)
    *,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make poses from a motion of AMASS, AIST++, a pose estimator or the like, or from a video.

    Args:
        source: .bvh, .npz, .npy, .pkl or .pt, or an estimator's folder; pickles are read without
            running their code. Or a video: its largest person, or --person.
        out: the poses, .npz.
        options: options of the conversion.
        video_options: for a video: what is known about it, and which part of it is used.
        lens: for a video: focal length, as 26mm (35 mm equivalent) or in pixels; without it, the
            one that the video records, else it is estimated.
        body: the avatar's body, if it is not the built-in body: its pelvis stays in place when
            the world is turned upright.
        overwrite: replace an existing file.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out}: a file of poses ends in .npz")
    require_room(out, overwrite)
    target = TargetBody.read(body)
    of_video = [*given(video_options).values(), *(["--lens"] if lens else [])]
    if source.suffix.lower() in VIDEO_FILES:
        known = PrepareVideoOptions(**vars(video_options))
        found = _of_video(source, known, lens, target, options)
    elif of_video:
        raise InputError(
            f"motion: {of_video[0]} is for videos ({', '.join(VIDEO_FILES)}); got {source}"
        )
    else:
        found = read_motion(source, target, options)
    save_poses(out, found.pose, found.shape, stage=1)
    for note in found.notes:
        say(f"{source}: {note}")
    say(f"{len(found.pose)} poses: {out}")


def _of_video(
    video: Path,
    known: PrepareVideoOptions,
    lens: str | None,
    body: TargetBody,
    options: MotionOptions,
) -> Motion:
    """Return the motion of one person in a video."""
    person = nth_person(options.person)
    with bar("motion") as shown:
        found = motion_of_video(video, known, body.model, person=person, lens=lens, progress=shown)
    solved, fps = found.solved, found.pictures.fps
    motion = motion_of_poses(str(video), solved.pose, solved.shape, fps, body, options)
    return replace(motion, notes=(*motion.notes, *found.notes))
