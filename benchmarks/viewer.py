"""Time an update of the viewer's picture, from a change of pose or camera to the JPEG.

An update poses the avatar if its pose changed, draws it at the coarse resolution of a changing
picture, composites it over the background, and encodes it by Pillow. Transfer to the browser and
the browser's own work are not included.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from functools import partial
from typing import get_args

import numpy as np
import torch

from benchmarks.timing import WARM_UP, Table, Timing, milliseconds
from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.core.threads import one_torch_thread
from gva_mi.splat import look_at
from gva_mi.viewer.cameras import coarser, lens, start
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.server import JPEG_QUALITY
from gva_mi.viewer.session import COARSE
from gva_mi.viewer.state import Mode, State

FRAMES = 24  # of the turn


def run(repeats: int, seed: int, gaussians: int = 20_000) -> Iterator[Table]:
    """Yield a table of all ways to show the avatar, after another pose and another camera."""
    body, pose = load_body(), Pose.rest(FRAMES)
    pose.rotations[:, 0, 1] = 2 * math.pi * torch.arange(FRAMES) / FRAMES
    options = AvatarOptions(seed=SeedOptions(count=gaussians))
    generator = torch.Generator().manual_seed(seed)
    avatar = seed_avatar(body, Shape(torch.zeros(body.num_betas)), None, options, generator)
    begin, rows, drawing = start(avatar.rig, pose), [], Drawing(avatar, pose)

    def update(mode: Mode, frame: int, nearer: float) -> None:
        eye = begin.position + nearer * (begin.look_at - begin.position)
        camera = lens(begin.fov, 1280, 720, look_at(eye, begin.look_at, begin.up))
        picture = drawing.picture(State(mode=mode, frame=frame), coarser(camera, COARSE), False)
        _packed(picture)

    with one_torch_thread():
        for mode in get_args(Mode):
            for name, change in (
                ("another pose", lambda k, mode=mode: update(mode, k % FRAMES, 0.0)),
                ("another camera", lambda k, mode=mode: update(mode, 0, 0.001 * k)),
            ):
                calls = [partial(change, k) for k in range(WARM_UP + repeats)]
                timing = Timing.of([milliseconds(call) for call in calls][WARM_UP:])
                rate = {"updates a second": 1e3 / timing.median}
                rows.append({"": f"{mode}, {name}"} | timing.columns | rate)
    yield Table(f"viewer, {gaussians:,} Gaussians, a browser of 1280 x 720 pixels", rows)


def _packed(picture: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(picture).save(io.BytesIO(), format="JPEG", quality=JPEG_QUALITY)
