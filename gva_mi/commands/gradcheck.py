"""The command ``gva-mi gradcheck``: are the gradients of the renderer, of an avatar, right?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from torch import Generator
from tyro.conf import Positional

from gva_mi.avatar.gradcheck import Report as AvatarReport
from gva_mi.avatar.gradcheck import Scene as AvatarScene
from gva_mi.avatar.gradcheck import gradcheck as check_avatar
from gva_mi.commands.arguments import Flat, Switch
from gva_mi.console import say
from gva_mi.errors import InputError
from gva_mi.files import require_writable
from gva_mi.ranges import Seed, Within, require_ranges
from gva_mi.splat import render
from gva_mi.splat.camera import CameraModel
from gva_mi.splat.gradcheck import Report as SplatReport
from gva_mi.splat.gradcheck import gradcheck as check
from gva_mi.splat.gradcheck.verdict import IMAGES, write_json, write_picture
from gva_mi.splat.scene import Scene, person_scene

REPORT, PICTURE = "gradcheck.json", "gradcheck.png"


@dataclass(frozen=True)
class GradcheckOptions:
    """Where to look, and through what: the defaults are the scene as it is."""

    # Width and height of a window, px; the time grows with its square and more.
    window: Annotated[int, Within(1, 1024)] = 24
    count: Annotated[int, Within(1, 1000)] = 3  # windows, from the fullest to the emptiest
    camera_model: CameraModel | None = None  # another one than the scene's own
    antialiased: Switch = False  # opacities less what the blur adds in area
    # Random features of this width in the place of the colours; 0 leaves them.
    channels: Annotated[int, Within(0, 1024)] = 0
    images: tuple[Literal["color", "alpha", "depth"], ...] = IMAGES  # that the loss looks at
    seed: Seed = 0  # of the loss, and of what is looked at closely

    def __post_init__(self) -> None:
        require_ranges("gradcheck", self)
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
    what: Positional[Literal["splat", "avatar"]] = "splat",
    options: Flat[GradcheckOptions] = GradcheckOptions(),  # noqa: B008 (frozen)
    *,
    scene: Path | None = None,
    body: Path | None = None,
    out: Path | None = None,
) -> None:
    """Compare every gradient of the renderer, or of a whole avatar, with independent answers.

    Of the renderer: a slow twin, differences and Dr.Jit's autodiff, in small windows of a picture.
    Of an avatar, from its pose to the picture: slow twins of every link, differences and tangents,
    and which link loses digits in float32. Ends with an error where a gradient is wrong, less
    accurate than allowed, or missing.

    Args:
        what: the renderer, or an avatar in random poses, of which the options count and seed tell
            how many.
        options: where to look, and through what.
        scene: of the renderer: a .ply, .splat or .spz, or an .npz file with means, quats, scales,
            opacities, sh or colors, viewmat, K, width, height, background; without it a person of
            20,000 Gaussians.
        body: of an avatar: a body in SMPL-X's .npz format; without it the built-in puppet.
        out: a folder for gradcheck.json and, of the renderer, gradcheck.png.
    """
    if what == "avatar":
        if scene is not None or options != GradcheckOptions(count=options.count, seed=options.seed):
            raise InputError("gradcheck avatar: of the options, it has --count, --seed and --body")
        asked = _avatars(options, body)
    else:
        if body is not None:
            raise InputError("gradcheck splat: there is no --body; a scene is given by --scene")
        asked = _windows(options, scene)
    if out is not None:
        require_writable(out)
    reports = {}
    for name, report in asked:
        reports[name] = report
        say(f"{name}:\n{report.table()}\n")
    if out is not None:
        write_json(reports, out / REPORT)
        say(f"figures: {out / REPORT}")
        if what == "splat":
            write_picture(reports, out / PICTURE)
            say(f"picture: {out / PICTURE}")
    failed = []
    for name, report in reports.items():
        missing = report.notes if what == "splat" else ()  # what a renderer may lack
        if not report.passed or missing:
            failed.append(f"{name}: {'; '.join([report.verdict, *missing])}")
    if failed:
        raise InputError(f"gradcheck: {'; '.join(failed)}")
    places = "poses" if what == "avatar" else "windows"
    say(f"gradients are right in all {len(reports)} {places}")


def _windows(options: GradcheckOptions, scene: Path | None) -> Iterator[tuple[str, SplatReport]]:
    """The renderer in windows of a picture."""
    whole = person_scene(np.random.default_rng(0)) if scene is None else Scene.load(scene)
    for place, part in options.applied(whole).windows(options.window, options.count):
        report = check(render, part, images=options.images, seed=options.seed)
        yield f"window at {place}", report


def _avatars(options: GradcheckOptions, body: Path | None) -> Iterator[tuple[str, AvatarReport]]:
    """An avatar in random poses."""
    for seed in range(options.seed, options.seed + options.count):
        yield f"pose {seed}", check_avatar(AvatarScene.random(seed, body=body), seed=seed)
