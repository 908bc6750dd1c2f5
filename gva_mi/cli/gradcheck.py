"""The commands ``gradcheck`` and ``bench``: gradients checked, and speed measured."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional

import gva_mi
from gva_mi.cli.parse import Flat, Switch, given
from gva_mi.core.atomic import require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.options import Seed, Within, options_of
from gva_mi.gradcheck.avatar import PosedAvatar, check_avatar
from gva_mi.gradcheck.engine import Report, write_reports
from gva_mi.gradcheck.normals import COORDINATES, SIZE, check_normals
from gva_mi.gradcheck.splat import gradcheck as check_renderer
from gva_mi.gradcheck.splat import write_picture
from gva_mi.splat import render
from gva_mi.splat.camera import CameraModel
from gva_mi.splat.scene import Scene, person_scene

CHECKOUT = Path(gva_mi.__file__).parents[1]  # the repository, whose benchmarks are not installed
REPORT, PICTURE = "gradcheck.json", "gradcheck.png"
What = Literal["splat", "avatar", "normals"]
ONLY: dict[str, tuple[What, ...]] = {  # options that only some checks have
    "seed": ("splat", "avatar"), "scene": ("splat",), "body": ("avatar",),
    **dict.fromkeys(("window", "camera_model", "antialiased"), ("splat",)),
}  # fmt: skip


@options_of("gradcheck")
class GradcheckOptions:
    """Options of the checks: which inputs they cover, and how finely."""

    # splat: number of windows, from fullest to emptiest (3); avatar: of random poses (3); normals:
    # of coordinates of the body's pose, from the first (all 16).
    count: Annotated[int, Within(1, 1000)] | None = None
    seed: Seed = 0  # for the loss weights and the choice of entries
    # splat: width and height of a window, px; the time grows faster than their product.
    window: Annotated[int, Within(1, 1024)] = 24
    camera_model: CameraModel | None = None  # splat: replaces the scene's own
    antialiased: Switch = False  # splat: reduce opacities by the area that the blur adds

    def require_only(self, what: What, **files: Path | None) -> None:
        """Raise an InputError for an option or a file that only another check has."""
        if what == "normals" and self.count is not None:
            Within(1, len(COORDINATES)).require("gradcheck normals", "count", self.count)
        named = {name: f"--{name}" for name, path in files.items() if path is not None}
        for name, option in (given(self) | named).items():
            if what not in ONLY.get(name, (what,)):
                raise InputError(
                    f"gradcheck {what}: there is no {option}; it is an option of "
                    f"`gva-mi gradcheck {ONLY[name][0]}`"
                )

    def applied(self, scene: Scene) -> Scene:
        """Return the scene with these options applied."""
        if self.camera_model is not None:
            scene = scene.through(self.camera_model)
        return replace(scene, options=replace(scene.options, antialiased=self.antialiased))


def gradcheck(
    what: Positional[What] = "splat",
    options: Flat[GradcheckOptions] = GradcheckOptions(),  # noqa: B008 (frozen)
    *,
    scene: Path | None = None,
    body: Path | None = None,
    out: Path | None = None,
) -> None:
    """Compare the gradients of the renderer, of an avatar or of rendered normals with references.

    splat: the renderer against its reference implementation and central differences, in small
    windows of a picture. avatar: the whole chain from a pose to the picture against differences and
    tangents. normals: mesh_normals by the body's pose against an exact reference. Ends with an
    error if a gradient is wrong, less accurate than allowed, or missing.

    Args:
        what: what to check.
        options: which inputs to check, and how finely.
        scene: splat: a .ply or .glb of Gaussians; without it, a person of 20,000 Gaussians.
        body: avatar: a body file in SMPL-X's format (.npz); without it, the built-in body.
        out: a folder for gradcheck.json and, for splat, gradcheck.png.
    """
    options.require_only(what, scene=scene, body=body)
    if out is not None:
        require_writable(out)
    checks = {"splat": lambda: _windows(options, scene), "avatar": lambda: _poses(options, body)}
    reports = {}
    for name, report in checks.get(what, lambda: _normals(options))():
        reports[name] = report
        say(f"{name}:\n{report.table()}\n")
    if out is not None:
        write_reports(reports, out / REPORT)
        say(f"figures: {out / REPORT}")
        if what == "splat":
            write_picture(reports, out / PICTURE)
            say(f"picture: {out / PICTURE}")
    failed = [
        f"{name}: {'; '.join([report.verdict, *report.notes])}"
        for name, report in reports.items()
        if not report.passed or report.notes  # a note: a gradient is missing
    ]
    if failed:
        raise InputError(f"gradcheck {what}: {'; '.join(failed)}")
    say(f"gradcheck {what}: all gradients are right")


def _windows(options: GradcheckOptions, scene: Path | None) -> Iterator[tuple[str, Report]]:
    """Check the renderer in windows of a picture."""
    whole = person_scene(np.random.default_rng(0)) if scene is None else Scene.load(scene)
    for place, part in options.applied(whole).windows(options.window, options.count or 3):
        yield f"window at {place}", check_renderer(render, part, seed=options.seed)


def _poses(options: GradcheckOptions, body: Path | None) -> Iterator[tuple[str, Report]]:
    """Check an avatar in random poses."""
    for seed in range(options.seed, options.seed + (options.count or 3)):
        yield f"pose {seed}", check_avatar(PosedAvatar.random(seed, body=body), seed=seed)


def _normals(options: GradcheckOptions) -> Iterator[tuple[str, Report]]:
    """Check the derivatives of ``mesh_normals`` with respect to coordinates of the body's pose."""
    count = options.count or len(COORDINATES)
    rows = []
    with bar("gradcheck") as progress:
        for done, found in enumerate(check_normals(count), 1):
            rows += found
            progress(done, count)
    yield "mesh_normals", Report(tuple(rows), f"{count} coordinates of the pose, {SIZE} px")


def bench(
    what: Positional[Literal["splat", "growth", "fit", "table"]],
    *,
    repeats: Annotated[int, Within(1, 100_000)] = 20,
    scene: Path | None = None,
    video: Path | None = None,
) -> None:
    """Measure the speed of the renderer, of larger scenes, of a fit, or of whole commands.

    Prints tables; on a shared machine trust only ratios within one run.

    Args:
        what: the part to measure; growth: larger scenes and more threads; table: the renderer, a
            step of the fit, and the steps of demo, avatar and batch.
        repeats: calls per figure.
        scene: splat: a .ply or .glb of Gaussians; without it, a person of 20,000 Gaussians at
            512 px.
        video: table: a video to make an avatar of; without it, a rendered one.
    """
    for of, option, file in (("splat", "scene", scene), ("table", "video", video)):
        if what != of and file is not None:
            raise InputError(f"bench {what}: --{option} is an option of bench {of}")
    if not (CHECKOUT / "benchmarks/splat.py").exists():
        raise InputError(
            "bench: benchmarks are in the repository and not in the installed package; clone it "
            f"and run there: python -m gva_mi bench {what}"
        )
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    given = {"path": scene, "video": video}
    options = {name: file for name, file in given.items() if file is not None}
    for table in import_module(f"benchmarks.{what}").run(repeats, **options):
        say(f"{table}\n")
