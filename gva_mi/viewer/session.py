"""The loop of an open viewer: one thread, one step after the other.

Other threads only record what browsers and their panel do. A step reads the newest state and draws
it, however many came since the last step: first with few pixels, and with all of them, as ``gva-mi
render`` would, once nothing has changed for a moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.lock import folder_lock
from gva_mi.data.video import save_cameras
from gva_mi.fit.renders import see_through
from gva_mi.splat import Camera
from gva_mi.viewer.cameras import ViewerCamera, coarser, fitted
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.keyframes import film
from gva_mi.viewer.state import State

COARSE = 640 * 360  # pixels while something changes
REST = 0.2  # seconds without a change before all pixels are drawn
TICK = 1 / 60  # seconds between two steps while a motion plays
Action = Literal["snapshot", "add keyframe", "remove keyframe", "save cameras"]


class Click(NamedTuple):
    """A pressed button."""

    action: Action
    browser: int  # where it was pressed


class Panel(Protocol):
    """The controls that all browsers share."""

    playing: bool

    def state(self, now: float) -> State:
        """Return what to show at a time, seconds."""

    def clicks(self) -> Iterator[Click]:
        """Yield the buttons pressed since the last call."""

    def count_keyframes(self, count: int) -> None:
        """Show the number of keyframes."""


class Browser(Protocol):
    """One page that shows pictures."""

    def camera(self) -> ViewerCamera | None:
        """Return its camera; None while it is unknown."""

    def show(self, picture: np.ndarray, fine: bool) -> None:
        """Show an 8-bit picture (H, W, 3), lossless if ``fine``."""

    def tell(self, sentence: str) -> None:
        """Show a sentence as a notification."""


@dataclass(frozen=True)
class SessionSetup:
    """What a session needs beside the drawing."""

    frames: int  # of the motion
    up: np.ndarray  # (3,) unit, world
    cameras: list[Camera]  # of the video's frames; none without a video
    out: Path  # folder of snapshots and camera paths


@dataclass(frozen=True)
class _LastPicture:
    """The last picture that a browser was sent."""

    wanted: tuple[State, ViewerCamera, int]
    since: float  # seconds
    fine: bool


class Session:
    """Draws what the panel asks for, for every open browser."""

    def __init__(self, drawing: Drawing, panel: Panel, setup: SessionSetup) -> None:
        self._drawing, self._panel, self._setup = drawing, panel, setup
        self._shown: dict[int, _LastPicture] = {}
        self._keyframes: list[ViewerCamera] = []
        self._changes = 0  # of the keyframes

    def step(self, browsers: Mapping[int, Browser], now: float) -> float:
        """Handle pressed buttons, then update every browser whose picture is out of date.

        Args:
            browsers: the open ones.
            now: seconds of a monotonic clock.

        Returns:
            Seconds until the next step is due even if nothing happens.
        """
        state = self._panel.state(now)
        for click in self._panel.clicks():
            browser = browsers.get(click.browser)  # None if it was just closed
            view = browser.camera() if browser is not None else None
            if view is not None and view.usable():
                browser.tell(self._done(click.action, state, view))
        self._shown = {k: shown for k, shown in self._shown.items() if k in browsers}
        pending = False
        for k, browser in browsers.items():
            view = browser.camera()
            if view is not None and view.usable():
                pending |= self._serve(k, browser, (state, view, self._changes), now)
        return TICK if self._panel.playing else REST if pending else 1.0

    def _serve(
        self, k: int, browser: Browser, wanted: tuple[State, ViewerCamera, int], now: float
    ) -> bool:
        """Update one browser; return whether its fine picture is still to come."""
        shown = self._shown.get(k)
        if shown is None or shown.wanted != wanted:
            browser.show(self.picture(*wanted[:2], fine=False), False)
            self._shown[k] = _LastPicture(wanted, now, False)
        elif not shown.fine and now - shown.since >= REST:
            browser.show(self.picture(*wanted[:2]), True)
            self._shown[k] = replace(shown, fine=True)
        return not self._shown[k].fine

    def picture(self, state: State, view: ViewerCamera, fine: bool = True) -> np.ndarray:
        """Draw what a browser shows, 8-bit (H, W, 3): ``fine``, or with few pixels."""
        camera = self._camera(state, view)
        if not fine:
            camera = coarser(camera, COARSE // 2 if self._beside(state) else COARSE)
        picture = self._drawing.picture(state, camera, fine)
        if not self._beside(state):
            return picture
        frame = self._drawing.frame(state, camera.width, camera.height)
        return np.concatenate([frame, picture], axis=1)

    def _beside(self, state: State) -> bool:
        return state.beside and bool(self._setup.cameras)

    def _camera(self, state: State, view: ViewerCamera) -> Camera:
        """Return the camera that the avatar is drawn with."""
        if self._beside(state):
            view = replace(view, width=view.width // 2)
        if state.seen_from == "video" and self._setup.cameras:
            return fitted(self._setup.cameras[state.frame], view.width, view.height)
        if state.seen_from == "keyframes" and self._keyframes:
            cameras = self._film(view)
            return cameras[state.frame % len(cameras)]
        return view.to_camera()

    def _film(self, view: ViewerCamera) -> list[Camera]:
        """Return cameras along the keyframes: one for each frame of the motion, or one for all."""
        setup = self._setup
        return film(self._keyframes, setup.up, setup.frames, view.width, view.height)

    def _done(self, action: Action, state: State, view: ViewerCamera) -> str:
        """Do what a button asks for; return a sentence about the result."""
        if action in ("add keyframe", "remove keyframe"):
            self._keyframes = self._keyframes + [view] if "add" in action else self._keyframes[:-1]
            self._changes += 1
            self._panel.count_keyframes(len(self._keyframes))
            return f"keyframes: {len(self._keyframes)}"
        if action == "save cameras" and not self._keyframes:
            return "there is no keyframe yet: add some"
        name = "snapshot_{}.png" if action == "snapshot" else "cameras_{}.npz"
        path = out = self._setup.out
        try:
            with folder_lock(out, "gva-mi view"):  # another viewer may want the same name
                path = free_name(out, name)
                if action == "snapshot":
                    self._write_snapshot(path, state, view)
                else:
                    save_cameras(path, self._film(view))
        except InputError as error:
            return str(error)
        except OSError as error:
            return f"{path}: cannot be written ({error.strerror})"
        say(f"saved: {path}")
        return f"saved: {path}"

    def _write_snapshot(self, path: Path, state: State, view: ViewerCamera) -> None:
        from PIL import Image

        if state.transparent:
            alone = replace(state, beside=False)
            image = see_through(self._drawing.layer(alone, self._camera(alone, view)))
        else:
            image = self.picture(state, view)
        with atomic_write(path) as unfinished:
            Image.fromarray(image).save(unfinished, "PNG")


def free_name(folder: Path, name: str) -> Path:
    """Return the first file of a series that does not exist; ``{}`` in ``name`` is its number."""
    number = 0
    while (path := folder / name.format(f"{number:03d}")).exists():
        number += 1
    return path
