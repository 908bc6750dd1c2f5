"""How often a viewer's picture can change: what one update costs, from a change to the JPEG.

An update is a step of the :class:`~gva_mi.viewer.session.Session`: the panel's state and the
browser's eye are read, the avatar is posed where its pose is another one, drawn with the few pixels
of a picture that changes, laid over the background, and packed as it is sent, by Pillow. What is
not in it is the way to the browser and the browser's own work: nobody looks.

The person is the puppet, turning before a browser of 1280 x 720 pixels. Times are wall clock, the
least and the median of repeated updates; on a shared machine trust ratios of one run.
"""

from __future__ import annotations

import io
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
import roma
import torch

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.fit.bench import Stage as Times
from gva_mi.splat import look_at
from gva_mi.threads import one_torch_thread
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.eyes import Eye, Start, start
from gva_mi.viewer.server import JPEG_QUALITY
from gva_mi.viewer.session import Click, Session, Stage
from gva_mi.viewer.state import Mode, State

WINDOW = (1280, 720)  # pixels of the browser
FRAMES = 24  # of the turn
_WARM_UP = 4  # updates before the first that counts


@dataclass(frozen=True)
class ViewerBench:
    """All figures of one run."""

    gaussians: int
    size: tuple[int, int]  # pixels of what is sent, width and height
    updates: tuple[Times, ...]  # each way to show the avatar: another pose, another eye

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        width, height = self.size
        lines = [f"{self.gaussians:,} Gaussians, {width} x {height} pixels, sent to nobody"]
        lines.append(f"{'ms an update':34}{'least':>9}{'median':>9}{'a second':>10}")
        for times in self.updates:
            rate = 1e3 / times.median
            lines.append(f"{times.name:34}{times.least:9.2f}{times.median:9.2f}{rate:10.1f}")
        return "\n".join(lines)


def bench_viewer(repeats: int, seed: int, gaussians: int = 20_000) -> ViewerBench:
    """Measure updates of a viewer.

    Args:
        repeats: updates per figure.
        seed: of the avatar's Gaussians.
        gaussians: how many.
    """
    body, pose = load_body(), Pose.rest(FRAMES)
    pose.rotations[:, 0, 1] = 2 * math.pi * torch.arange(FRAMES) / FRAMES
    options = AvatarOptions(seed=SeedOptions(count=gaussians))
    generator = torch.Generator().manual_seed(seed)
    avatar = seed_avatar(body, Shape(torch.zeros(body.num_betas)), None, options, generator)
    begin = start(avatar.rig, pose)
    found = []
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        drawing = Drawing(avatar, pose)
        for mode in get_args(Mode):
            panel, page = _Panel(State(mode=mode)), _Page(begin)
            session = Session(drawing, panel, Stage(FRAMES, begin.up, [], Path(folder)))
            for name, change in (("another pose", panel.turn), ("another eye", page.walk)):
                times = _timed(session, page, change, repeats)
                found.append(Times.of(f"{mode}, {name}", times))
    return ViewerBench(len(avatar.canonical), page.size, tuple(found))


def _timed(session: Session, page: _Page, change: Callable[[], None], repeats: int) -> list[float]:
    """Milliseconds of each update after a change."""
    times = []
    for _ in range(_WARM_UP + repeats):
        change()
        then = time.perf_counter()
        session.step({0: page}, then)
        times.append(1e3 * (time.perf_counter() - then))
    return times[_WARM_UP:]


@dataclass
class _Panel:
    """Controls that nobody but :meth:`turn` touches."""

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
