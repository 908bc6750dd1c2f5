"""An update of the viewer's picture, from a change to the JPEG.

An update is a step of the :class:`~gva_mi.viewer.session.Session`: the panel's state and the
browser's camera are read, the avatar is posed if its pose changed, drawn, laid over the background,
and packed by Pillow as it is sent. The way to the browser and the browser's work are not in it.
"""

from __future__ import annotations

import io
import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
import roma
import torch

from benchmarks.timing import WARM_UP, Table, Timing
from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.splat import look_at
from gva_mi.threads import one_torch_thread
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.eyes import Eye, Start, start
from gva_mi.viewer.server import JPEG_QUALITY
from gva_mi.viewer.session import Click, Session, Stage
from gva_mi.viewer.state import Mode, State

WINDOW = (1280, 720)  # pixels of the browser
FRAMES = 24  # of the turn


def run(repeats: int, seed: int, gaussians: int = 20_000) -> Iterator[Table]:
    """Yield a table of all ways to show the avatar, after another pose and another camera."""
    body, pose = load_body(), Pose.rest(FRAMES)
    pose.rotations[:, 0, 1] = 2 * math.pi * torch.arange(FRAMES) / FRAMES
    options = AvatarOptions(seed=SeedOptions(count=gaussians))
    generator = torch.Generator().manual_seed(seed)
    avatar = seed_avatar(body, Shape(torch.zeros(body.num_betas)), None, options, generator)
    begin, rows = start(avatar.rig, pose), []
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        drawing = Drawing(avatar, pose)
        for mode in get_args(Mode):
            panel, page = _Panel(State(mode=mode)), _Page(begin)
            session = Session(drawing, panel, Stage(FRAMES, begin.up, [], Path(folder)))
            for name, change in (("another pose", panel.turn), ("another camera", page.walk)):
                times = []
                for _ in range(WARM_UP + repeats):
                    change()
                    then = time.perf_counter()
                    session.step({0: page}, then)
                    times.append(1e3 * (time.perf_counter() - then))
                timing = Timing.of(times[WARM_UP:])
                per_second = {"updates a second": 1e3 / timing.median}
                rows.append({"": f"{mode}, {name}"} | timing.columns | per_second)
    width, height = page.size
    yield Table(f"viewer, {gaussians:,} Gaussians, {width} x {height} pixels", rows)


@dataclass
class _Panel:
    """Controls that only :meth:`turn` touches."""

    shown: State
    playing: bool = True

    def turn(self) -> None:
        self.shown = replace(self.shown, frame=(self.shown.frame + 1) % FRAMES)

    def state(self, now: float) -> State:
        return self.shown

    def clicks(self) -> Iterator[Click]:
        return iter(())

    def count_keyframes(self, count: int) -> None:
        pass


@dataclass
class _Page:
    """A browser that walks round the person and packs what it is shown."""

    begin: Start
    angle: float = 0.0  # radians
    size: tuple[int, int] = field(default=(0, 0))  # of the last picture

    def walk(self) -> None:
        self.angle += 0.05

    def eye(self) -> Eye:
        begin = self.begin
        about = roma.rotvec_to_rotmat(torch.as_tensor(self.angle * np.asarray(begin.up))).numpy()
        at = np.asarray(begin.look_at)
        position = at + about @ (np.asarray(begin.position) - at)
        R = torch.from_numpy(look_at(position, at, begin.up)[:3, :3].T.copy())
        x, y, z, w = roma.rotmat_to_unitquat(R).tolist()
        places = tuple(map(float, position)), tuple(map(float, at))
        return Eye(*places, (w, x, y, z), begin.fov, *WINDOW)

    def show(self, picture: np.ndarray, fine: bool) -> None:
        from PIL import Image

        self.size = picture.shape[1], picture.shape[0]
        kind = {"format": "PNG"} if fine else {"format": "JPEG", "quality": JPEG_QUALITY}
        Image.fromarray(picture).save(io.BytesIO(), **kind)

    def tell(self, sentence: str) -> None:
        pass
