"""The commands that examine the kernels: are the gradients right, and how fast are they?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from tyro.conf import Positional, arg

from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.splat.bench import BenchOptions
from gva_mi.splat.bench import bench as measure
from gva_mi.splat.gradcheck import gradcheck as check
from gva_mi.splat.scene import Scene, person_scene
from gva_mi.splat.torch_op import render
from gva_mi.splat.verdict import write_json, write_picture

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line

REPORT, PICTURE = "gradcheck.json", "gradcheck.png"


def gradcheck(
    *, scene: Path | None = None, out: Path | None = None, window: int = 24, count: int = 3
) -> None:
    """Compare every gradient of the renderer with a slow twin, differences and Dr.Jit's autodiff.

    Checks small windows of the picture, from the fullest to the emptiest. Ends with an error where
    a gradient is wrong or less accurate than allowed.

    Args:
        scene: an .npz file with means, quats, scales, opacities, sh or colors, viewmat, K, width,
            height, background; without it a person of 20,000 Gaussians.
        out: a folder for gradcheck.json and gradcheck.png.
        window: width and height of a window, pixels; the time grows with its square and more.
        count: how many windows.
    """
    if window < 1 or count < 1:
        raise InputError(f"gradcheck: --window and --count must be positive, got {window}, {count}")
    whole = person_scene(np.random.default_rng(0)) if scene is None else Scene.load(scene)
    reports = {}
    for place, part in whole.windows(window, count):
        reports[place] = report = check(render, part)
        say(f"window at {place}:\n{report.table()}\n")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(reports, out / REPORT)
        write_picture(reports, out / PICTURE)
        say(f"figures: {out / REPORT}; picture: {out / PICTURE}")
    failed = [
        f"at {place} {report.verdict}" for place, report in reports.items() if not report.passed
    ]
    if failed:
        raise InputError(f"gradcheck: {'; '.join(failed)}")
    say(f"gradients are right in all {len(reports)} windows")


def bench(
    what: Positional[Literal["splat"]],
    options: Flat[BenchOptions],
    *,
    scene: Path | None = None,
    json_file: Annotated[Path | None, arg(name="json")] = None,
) -> None:
    """Measure the renderer: milliseconds per stage, shares of the machine's limits, growth.

    Args:
        what: the part to measure.
        options: what to measure, and how often.
        scene: an .npz file as for gradcheck; without it a person of 20,000 Gaussians at 512 px.
        json_file: where to write all figures.
    """
    given = None if scene is None else Scene.load(scene)
    with bar("bench") as progress:
        found = measure(given, options, progress)
    say(found.table())
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(found.to_dict(), indent=1) + "\n")
        say(f"figures: {json_file}")
