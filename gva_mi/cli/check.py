"""The command ``gva-mi check``: find what is wrong with a subject's folder, in one pass."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from tyro.conf import Positional

from gva_mi.app.steps import body_of
from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Switch
from gva_mi.core.console import bar, say
from gva_mi.core.files import require_room, write_json
from gva_mi.data.check import check_subject
from gva_mi.data.pictures import require_picture

WRONG = 1  # exit code


def check(
    subject: Positional[Path],
    *,
    poses: Path | None = None,
    body: Path | None = None,
    json: Path | None = None,
    sheet: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Find what is wrong with a subject's folder, in one pass: files, axes, units, poses.

    The exit code 0 means no error, 1 at least one, and 2 that the folder cannot be read.

    Args:
        subject: the folder.
        poses: another file of poses than its poses.npz, such as the refined ones.
        body: the body that its poses are for, in SMPL-X's format; without it the one that it was
            prepared for, else the built-in body.
        json: also write all findings with all their frames to this file.
        sheet: also write a picture (.png) of some frames with the outlines of mask and body.
        overwrite: replace these files.
    """
    model = load_body(body_of(subject, body))
    if json is not None:
        require_room(json, overwrite)
    if sheet is not None:
        require_picture(sheet, overwrite)
    with bar("check") as progress:
        report = check_subject(subject, model, poses, progress, sheet)
    for line in report.lines(max(60, shutil.get_terminal_size().columns)):
        say(line)
    for line in report.skipped:
        say(f"{subject}: {line}")
    errors, doubts = len(report.errors), len(report.problems) - len(report.errors)
    agree = f"; mean IoU of body and masks {report.figures['iou']:.2f}" if report.figures else ""
    say(f"{subject}: {report.frames} frames, {errors} errors, {doubts} doubtful{agree}")
    if json is not None:
        write_json(json, report.to_json())
        say(f"findings: {json}")
    if sheet is not None and not report.skipped:
        say(f"sheet: {sheet}")
    if errors:
        sys.exit(WRONG)
