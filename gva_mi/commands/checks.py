"""The commands that examine the kernels: are the gradients right, and how fast are they?"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from torch import Generator
from tyro.conf import Positional, arg

from gva_mi.body.bench import bench_body
from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.mesh.bench import bench_normals
from gva_mi.mesh.gradcheck import LIMITS, GradientOptions, check_gradients, table
from gva_mi.splat.bench import BenchOptions
from gva_mi.splat.bench import bench as measure
from gva_mi.splat.camera import CameraModel
from gva_mi.splat.gradcheck import gradcheck as check
from gva_mi.splat.gradcheck.verdict import IMAGES, write_json, write_picture
from gva_mi.splat.scene import Scene, person_scene
from gva_mi.splat.torch_op import render

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line

REPORT, PICTURE = "gradcheck.json", "gradcheck.png"


@dataclass(frozen=True)
class GradcheckOptions:
    """Where to look, and through what: the defaults are the scene as it is."""

    window: int = 24  # width and height of a window, px; the time grows with its square and more
    count: int = 3  # windows, from the fullest to the emptiest
    camera_model: CameraModel | None = None  # another one than the scene's own
    antialiased: bool = False  # opacities less what the blur adds in area
    channels: int = 0  # random features of this width in the place of the colours; 0 leaves them
    images: tuple[Literal["color", "alpha", "depth"], ...] = IMAGES  # that the loss looks at
    seed: int = 0  # of the loss, and of what is looked at closely

    def __post_init__(self) -> None:
        if self.window < 1 or self.count < 1 or self.channels < 0:
            found = f"{self.window}, {self.count}, {self.channels}"
            raise InputError(
                f"gradcheck: window and count must be 1 or more, channels 0 or more, got {found}"
            )
        if not self.images:
            raise InputError(f"gradcheck: images must be some of {', '.join(IMAGES)}")

    def applied(self, scene: Scene) -> Scene:
        """The scene seen so."""
        if self.camera_model is not None:
            scene = scene.through(self.camera_model)
        if self.channels:
            scene = scene.featured(self.channels, Generator().manual_seed(self.seed))
        return replace(scene, options=replace(scene.options, antialiased=self.antialiased))


def gradcheck(
    options: Flat[GradcheckOptions] = GradcheckOptions(),  # noqa: B008 (frozen)
    *,
    scene: Path | None = None,
    out: Path | None = None,
) -> None:
    """Compare every gradient of the renderer with a slow twin, differences and Dr.Jit's autodiff.

    Checks small windows of the picture. Ends with an error where a gradient is wrong, less accurate
    than allowed, or missing.

    Args:
        options: where to look, and through what.
        scene: an .npz file with means, quats, scales, opacities, sh or colors, viewmat, K, width,
            height, background; without it a person of 20,000 Gaussians.
        out: a folder for gradcheck.json and gradcheck.png.
    """
    whole = person_scene(np.random.default_rng(0)) if scene is None else Scene.load(scene)
    reports = {}
    for place, part in options.applied(whole).windows(options.window, options.count):
        report = check(render, part, images=options.images, seed=options.seed)
        reports[place] = report
        say(f"window at {place}:\n{report.table()}\n")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(reports, out / REPORT)
        write_picture(reports, out / PICTURE)
        say(f"figures: {out / REPORT}; picture: {out / PICTURE}")
    failed = []
    for place, report in reports.items():
        if not report.passed or report.notes:
            failed.append(f"at {place} {'; '.join([report.verdict, *report.notes])}")
    if failed:
        raise InputError(f"gradcheck: {'; '.join(failed)}")
    say(f"gradients are right in all {len(reports)} windows")


def gradcheck_normals(options: Flat[GradientOptions]) -> None:
    """Compare the gradients of ``mesh_normals`` by the body's pose with exact ones.

    Mask, interior and boundary apart, for limbs that are free, occlude, cross and pierce. Ends with
    an error where one is further off than allowed.
    """
    rows = []
    with bar("gradcheck") as progress:
        for row in check_gradients(options):
            rows.append(row)
            progress(len(rows), options.count)
    say(table(rows))
    failed = [f"{row.pose} {row.moves}" for row in rows if not row.passed]
    if failed:
        limits = ", ".join(f"{name} {limit:.0%}" for name, limit in LIMITS.items())
        raise InputError(f"gradcheck-normals: above {limits}: {'; '.join(failed)}")


def bench(
    what: Positional[Literal["splat", "body", "normals"]],
    options: Flat[BenchOptions],
    *,
    scene: Path | None = None,
    json_file: Annotated[Path | None, arg(name="json")] = None,
) -> None:
    """Measure the renderer: milliseconds per stage, shares of the machine's limits, growth; or
    the body model: milliseconds per stage, for one frame and for a hundred; or the normals that the
    refinement looks at: milliseconds per stage of one step.

    Args:
        what: the part to measure. Of the options, body and normals heed repeats and seed.
        options: what to measure, and how often.
        scene: an .npz file as for gradcheck; without it a person of 20,000 Gaussians at 512 px.
        json_file: where to write all figures.
    """
    if what != "splat" and scene is not None:
        raise InputError(f"bench {what}: there is no --scene, the body is the command's own")
    if what == "body":
        found = bench_body(options.repeats, options.seed)
    elif what == "normals":
        found = bench_normals(options.repeats, options.seed)
    else:
        given = None if scene is None else Scene.load(scene)
        with bar("bench") as progress:
            found = measure(given, options, progress)
    say(found.table())
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(found.to_dict(), indent=1) + "\n")
        say(f"figures: {json_file}")
