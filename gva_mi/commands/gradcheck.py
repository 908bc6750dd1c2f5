"""The command ``gva-mi gradcheck``: are the gradients of the renderer right?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from torch import Generator

from gva_mi.commands.arguments import Flat, Switch
from gva_mi.console import say
from gva_mi.errors import InputError
from gva_mi.splat import render
from gva_mi.splat.camera import CameraModel
from gva_mi.splat.gradcheck import gradcheck as check
from gva_mi.splat.gradcheck.verdict import IMAGES, write_json, write_picture
from gva_mi.splat.scene import Scene, person_scene

REPORT, PICTURE = "gradcheck.json", "gradcheck.png"


@dataclass(frozen=True)
class GradcheckOptions:
    """Where to look, and through what: the defaults are the scene as it is."""

    window: int = 24  # width and height of a window, px; the time grows with its square and more
    count: int = 3  # windows, from the fullest to the emptiest
    camera_model: CameraModel | None = None  # another one than the scene's own
    antialiased: Switch = False  # opacities less what the blur adds in area
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
        """The scene under these options."""
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
