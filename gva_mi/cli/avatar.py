"""The commands ``avatar`` and ``demo``: all steps, on a video or on a synthetic subject."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gva_mi import app
from gva_mi.app import AvatarEffort, DemoOptions
from gva_mi.cli.parse import MOST_PEOPLE, Flat, Switch
from gva_mi.core.options import Within
from gva_mi.readers.own_masks import MaskOptions
from gva_mi.stage1.prepare import PrepareVideoOptions


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
