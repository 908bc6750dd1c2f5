"""The commands ``avatar`` and ``demo``: all steps; ``synth`` and ``body``: what they begin with."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gva_mi import app
from gva_mi.app import AvatarEffort, DemoOptions
from gva_mi.body.anny import anny_body
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.smplx import load_body
from gva_mi.cli.parse import MOST_PEOPLE, Flat, Switch
from gva_mi.core.atomic import atomic_write, require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_replaceable, require_room
from gva_mi.core.options import Within
from gva_mi.core.tasks import usual_workers
from gva_mi.readers.own_masks import MaskOptions
from gva_mi.stage1.prepare import PrepareVideoOptions
from gva_mi.subject.folder import SYNTH
from gva_mi.synthetic import SynthOptions, make_subject


def avatar(
    video: Positional[Path],
    video_options: Flat[PrepareVideoOptions] = PrepareVideoOptions(),  # noqa: B008 (frozen)
    effort: Flat[AvatarEffort] = AvatarEffort(),  # noqa: B008 (frozen)
    own_masks: Flat[MaskOptions] = MaskOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    person: Annotated[int, Within(1, MOST_PEOPLE)] | None = None,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make an avatar from a video: prepare, check, refine, fit, evaluate, report.

    If it was interrupted, the same command resumes it. With other options, the command repeats only
    the steps that depend on them. Each step is also a command of its own.

    Args:
        video: a video file of one person who turns around once, or a folder of its pictures.
        video_options: what is known about the video.
        effort: how much work is spent on the avatar.
        own_masks: masks that come from another program.
        out: folder for the subject (out/subject), the run (out/run), videos and the page
            (out/report.html).
        person: if the video shows several, the person's number from the left; without it, the
            largest person.
        lens: focal length, as 26mm (35 mm equivalent) or in pixels; without it, the one that the
            video records, else it is estimated.
        body: a body file in SMPL-X's format; without it, the built-in body.
        overwrite: replace an existing avatar.
    """
    app.avatar(
        video, out, video_options, effort, own_masks, person=person, lens=lens, body=body,
        overwrite=overwrite,
    )  # fmt: skip


def demo(
    options: Flat[DemoOptions] = DemoOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    overwrite: Switch = False,
) -> None:
    """Run all steps on a synthetic subject: synth, refine, fit, evaluate, report.

    Args:
        options: size of the demo.
        out: folder for the subject (out/subject), the run and its report (out/run).
        overwrite: replace an existing demo.
    """
    app.demo(out, options, overwrite=overwrite)


def synth(
    out: Positional[Path],
    options: Flat[SynthOptions] = SynthOptions(),  # noqa: B008 (frozen)
    *,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras, inaccurate poses, ground truth.

    Args:
        out: the subject's folder.
        options: options of the subject.
        body: a body file in SMPL-X's format (.npz); without it, the built-in body.
        overwrite: replace an existing subject.
    """
    model, options = load_body(body), replace(options, workers=usual_workers())
    require_replaceable(out, SYNTH, overwrite)
    require_writable(out.absolute().parent)
    with bar("synth") as progress:
        make_subject(out, options, model, progress, SYNTH if overwrite else None)
    say(f"subject: {out}")


def body(
    *,
    source: Literal["built-in", "anny"] = "built-in",
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write a body file in SMPL-X's format that needs no licence agreement.

    To convert poses of SMPL or SMPL+H, use gva-mi motion, or with a video gva-mi prepare
    parameters.

    Args:
        source: "built-in", the built-in body, or "anny", the free realistic body.
        out: the body file, .npz; without it, a file named after the source in the working folder.
        overwrite: replace an existing file.
    """
    out = Path(f"{source}.npz") if out is None else out
    if out.suffix != ".npz":
        raise InputError(f"{out}: a body file ends in .npz")
    require_room(out, overwrite)
    path = anny_body() if source == "anny" else BUILT_IN_BODY
    with atomic_write(out) as unfinished:
        shutil.copyfile(path, unfinished)
    say(str(out))
