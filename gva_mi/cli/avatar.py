"""The commands ``avatar`` and ``demo``: all steps, on a video or on a synthetic subject."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gva_mi import app
from gva_mi.app import AvatarEffort, DemoOptions
from gva_mi.cli.arguments import MOST_PEOPLE, Flat, Switch
from gva_mi.core.options import Within
from gva_mi.readers.own_masks import MaskOptions
from gva_mi.stage1.prepare import RecordingOptions


def avatar(
    recording: Positional[Path],
    video_options: Flat[RecordingOptions] = RecordingOptions(),  # noqa: B008 (frozen)
    effort: Flat[AvatarEffort] = AvatarEffort(),  # noqa: B008 (frozen)
    own_masks: Flat[MaskOptions] = MaskOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    person: Annotated[int, Within(1, MOST_PEOPLE)] | None = None,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make an avatar of a video: prepare, check, refine, fit, evaluate, report.

    If it was interrupted, the same command goes on; with other options it repeats only the steps
    that depend on them. Each step is also a command of its own.

    Args:
        recording: a video of one person who turns round once, or a folder of its pictures.
        video_options: of the video.
        effort: how much work the avatar is worth.
        own_masks: masks that come from another program.
        out: folder for the subject (out/subject), the run (out/run), videos and the page
            (out/report.html).
        person: where there are several, the number from the left; without it, the largest.
        lens: focal length, as 26mm of 35 mm film or in pixels; without it, what the video records,
            else a fitted one.
        body: a body in SMPL-X's format; without it the built-in body.
        overwrite: replace an avatar that is there.
    """
    app.avatar(
        recording, out, video_options, effort, own_masks, person=person, lens=lens, body=body,
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
        overwrite: replace a demo that is there.
    """
    app.demo(out, options, overwrite=overwrite)
