"""What happens while a viewer is open, one step after the other, in one thread.

Whatever browsers and their panel do in other threads is only noted down. A step reads the newest
state and draws that one, however many there were since the last: at first with few pixels, and once
nothing has changed for a moment with all of them, as ``gva-mi render`` would.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from gva_mi.console import say
from gva_mi.data.video import save_cameras
from gva_mi.errors import InputError
from gva_mi.files import replacing
from gva_mi.fit.renders import see_through
from gva_mi.lock import alone_in
from gva_mi.splat import Camera
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.eyes import Eye, coarser, fitted
from gva_mi.viewer.keyframes import film
from gva_mi.viewer.state import State

COARSE = 640 * 360  # pixels while something changes
REST = 0.2  # seconds without a change after which all pixels are drawn
TICK = 1 / 60  # seconds between two looks at a motion that plays
Action = Literal["snapshot", "add keyframe", "remove keyframe", "save cameras"]


class Click(NamedTuple):
    """A button that was pressed."""

    action: Action
    browser: int  # whose


class Panel(Protocol):
    """The controls, which all browsers share."""

    playing: bool

    def state(self, now: float) -> State:
        """What is to be shown at a time, seconds."""

    def clicks(self) -> Iterator[Click]:
        """The buttons pressed since the last call."""

    def count_keyframes(self, count: int) -> None:
        """Say how many keyframes there are."""


class Browser(Protocol):
    """One page that shows pictures."""

    def eye(self) -> Eye | None:
        """Where it looks from; None while it does not say."""

    def show(self, picture: np.ndarray, fine: bool) -> None:
        """Show an 8-bit picture (H, W, 3); ``fine``: without loss."""

    def tell(self, sentence: str) -> None:
        """Show a sentence."""


@dataclass(frozen=True)
class Stage:
    """What a session is about, beside the drawing."""

    frames: int  # of the motion
    up: np.ndarray  # (3,) unit, world
    cameras: list[Camera]  # of the video's frames; none without a video
    out: Path  # folder of snapshots and camera paths


@dataclass(frozen=True)
class _Shown:
    """What a browser has been shown."""

    wanted: tuple[State, Eye, int]
    since: float  # seconds
    fine: bool


class Session:
    """Draws for some browsers what their panel says."""

    def __init__(self, drawing: Drawing, panel: Panel, stage: Stage) -> None:
        self._drawing, self._panel, self._stage = drawing, panel, stage
        self._shown: dict[int, _Shown] = {}
        self._keyframes: list[Eye] = []
        self._changes = 0  # of the keyframes

    def step(self, browsers: Mapping[int, Browser], now: float) -> float:
        """Do what was asked for, and show every browser what it does not show yet.

        Args:
            browsers: those that are open.
            now: seconds on any clock that goes on.

        Returns:
            Seconds after which there may be something to do, even if nothing happens.
        """
        state = self._panel.state(now)
        for click in self._panel.clicks():
            browser = browsers.get(click.browser)  # None: it was closed just now
            eye = browser.eye() if browser is not None else None
            if eye is not None and eye.usable():
                browser.tell(self._done(click.action, state, eye))
        self._shown = {k: shown for k, shown in self._shown.items() if k in browsers}
        pending = False
        for k, browser in browsers.items():
            eye = browser.eye()
            if eye is not None and eye.usable():
                pending |= self._serve(k, browser, (state, eye, self._changes), now)
        return TICK if self._panel.playing else REST if pending else 1.0

    def _serve(self, k: int, browser: Browser, wanted: tuple[State, Eye, int], now: float) -> bool:
        """Show what is missing; whether more will be, once nothing has changed for a moment."""
        shown = self._shown.get(k)
        if shown is None or shown.wanted != wanted:
            browser.show(self.picture(*wanted[:2], fine=False), False)
            self._shown[k] = _Shown(wanted, now, False)
        elif not shown.fine and now - shown.since >= REST:
            browser.show(self.picture(*wanted[:2]), True)
            self._shown[k] = replace(shown, fine=True)
        return not self._shown[k].fine

    def picture(self, state: State, eye: Eye, fine: bool = True) -> np.ndarray:
        """What a browser shows, 8-bit (H, W, 3): ``fine``, or with few pixels."""
        camera = self._camera(state, eye)
        if not fine:
            camera = coarser(camera, COARSE // 2 if self._beside(state) else COARSE)
        picture = self._drawing.picture(state, camera, fine)
        if not self._beside(state):
            return picture
        frame = self._drawing.frame(state, camera.width, camera.height)
        return np.concatenate([frame, picture], axis=1)

    def _beside(self, state: State) -> bool:
        return state.beside and bool(self._stage.cameras)

    def _camera(self, state: State, eye: Eye) -> Camera:
        """Through which the avatar is seen."""
        if self._beside(state):
            eye = replace(eye, width=eye.width // 2)
        if state.seen_from == "video" and self._stage.cameras:
            return fitted(self._stage.cameras[state.frame], eye.width, eye.height)
        if state.seen_from == "keyframes" and self._keyframes:
            cameras = self._film(eye)
            return cameras[state.frame % len(cameras)]
        return eye.camera()

    def _film(self, eye: Eye) -> list[Camera]:
        """Cameras along the keyframes: one for each frame of the motion, or one for all."""
        stage = self._stage
        return film(self._keyframes, stage.up, stage.frames, eye.width, eye.height)

    def _done(self, action: Action, state: State, eye: Eye) -> str:
        """Do what a button says, and say what came of it."""
        if action in ("add keyframe", "remove keyframe"):
            self._keyframes = self._keyframes + [eye] if "add" in action else self._keyframes[:-1]
            self._changes += 1
            self._panel.count_keyframes(len(self._keyframes))
            return f"keyframes: {len(self._keyframes)}"
        if action == "save cameras" and not self._keyframes:
            return "there is no keyframe yet: add some"
        name = "snapshot_{}.png" if action == "snapshot" else "cameras_{}.npz"
        path = out = self._stage.out
        try:
            with alone_in(out, "gva-mi view"):  # another viewer may be about to take the same name
                path = free_name(out, name)
                if action == "snapshot":
                    self._write_snapshot(path, state, eye)
                else:
                    save_cameras(path, self._film(eye))
        except InputError as error:
            return str(error)
        except OSError as error:
            return f"{path}: cannot be written ({error.strerror})"
        say(f"saved: {path}")
        return f"saved: {path}"

    def _write_snapshot(self, path: Path, state: State, eye: Eye) -> None:
        from PIL import Image

        if state.see_through:
            alone = replace(state, beside=False)
            image = see_through(self._drawing.layer(alone, self._camera(alone, eye)))
        else:
            image = self.picture(state, eye)
        with replacing(path) as unfinished:
            Image.fromarray(image).save(unfinished, "PNG")


def free_name(folder: Path, name: str) -> Path:
    """The first file of a series that is not there yet; ``name`` has ``{}`` for its number."""
    number = 0
    while (path := folder / name.format(f"{number:03d}")).exists():
        number += 1
    return path
