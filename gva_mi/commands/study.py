"""The command ``gva-mi study``: how well a step does on people that it was not tuned on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import numpy as np
from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.commands.arguments import Flat
from gva_mi.console import bar, say
from gva_mi.files import versions, write_json
from gva_mi.pose.evaluation.measure import REGIONS
from gva_mi.pose.evaluation.study import HELD_OUT, TUNING, CaseResult, StudyOptions
from gva_mi.pose.evaluation.study import study as refine_cases

CASES = {"held-out": HELD_OUT, "tuning": TUNING, "all": (*TUNING, *HELD_OUT)}


def study(
    what: Positional[Literal["refine"]],
    options: Flat[StudyOptions],
    *,
    out: Path,
    cases: Literal["held-out", "tuning", "all"] = "held-out",
    body: Path | None = None,
) -> None:
    """Refine several synthetic people and print how far their poses are from the truth.

    Args:
        what: the step that is studied; its figures are written to a file of its name, refine.json.
        options: how large the study is.
        out: folder for that file, and for the subjects, which are made where they are missing.
        cases: people the refinement was not tuned on, those it was, or all.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
    """
    figures = out / f"{what}.json"
    model = load_body(body)
    rows = []
    with bar("study") as progress:
        for row in refine_cases(out, CASES[cases], model, options, progress):
            rows.append(row)
            write_json(figures, _record(rows, options))
    for line in _table(rows):
        say(line)
    say(f"figures: {figures}")


def _table(rows: Sequence[CaseResult]) -> Iterator[str]:
    """Before and after in millimetres, a line for each row, and the mean of the changes."""
    cells = [
        (
            f"{row.case.name}, noise {row.noise:g}",
            *(f"{row.stage1_mm[p]:.0f} → {row.refined_mm[p]:.0f}" for p in REGIONS),
            f"{row.measured.means.iou.refined - row.measured.means.iou_truth:+.3f}",
            f"{row.measured.means.iou_true_masks:.3f}",
            f"{100 * row.measured.means.frames_worse:.0f} %",
            f"{100 * row.measured.means.frames_worse_hands:.0f} %",
            f"{row.measured.means.seconds_per_frame:.2f}",
        )
        for row in rows
    ]
    mean = [f"{100 * np.nanmean([row.change[p] for row in rows]):+.0f} %" for p in REGIONS]
    head = ("mm", *(p.replace("_", " ") for p in REGIONS), "IoU - truth's", "IoU, true masks")
    head += ("worse", "worse hands", "s a frame")
    lines = [head, *cells, ("mean change", *mean, *[""] * 5)]
    widths = [max(len(cell) for cell in column) for column in zip(*lines, strict=True)]
    for first, *others in lines:
        padded = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  ".join([first.ljust(widths[0]), *padded]).rstrip()


def _record(rows: Sequence[CaseResult], options: StudyOptions) -> dict:
    """What the file of figures holds."""
    found = [
        {
            "case": asdict(row.case),
            "noise": row.noise,
            "stage1_mm": row.stage1_mm,
            "refined_mm": row.refined_mm,
            "change": row.change,
            "figures": row.measured.means.to_json(),
        }
        for row in rows
    ]
    return {"rows": found, "options": asdict(options), "versions": versions()}
