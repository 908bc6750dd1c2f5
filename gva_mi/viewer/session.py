"""The loop of an open viewer: one thread, one step after the other.

Other threads only record what browsers and their panel do. A step reads the newest state and draws
it, however many came since the last step: first with few pixels, and with all of them, as ``gva-mi
render`` would, once nothing has changed for a moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np

from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.lock import folder_lock
from gva_mi.data.cameras import save_cameras
from gva_mi.data.pictures import write_image
from gva_mi.fit.renders import to_rgba
from gva_mi.splat import Camera
from gva_mi.viewer.cameras import ViewerCamera, coarser, film, fitted
from gva_mi.viewer.controls import Action, Controls
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.server import Page
from gva_mi.viewer.state import State

COARSE = 640 * 360  # pixels while something changes
REST = 0.2  # seconds without a change before all pixels are drawn
TICK = 1 / 60  # seconds between two steps while a motion plays


Wanted = tuple[State, ViewerCamera, tuple[ViewerCamera, ...]]  # with the keyframes


class Session:
    """Draw the panel's state for every open page.

    Args:
        drawing: of the avatar and its motion.
        panel: the controls that all pages share.
        up: (3,) unit, world, the axis of the pages' orbits.
        out: folder of snapshots and cameras.
        cameras: of the video's frames; none without a video.
    """

    def __init__(
        self,
        drawing: Drawing,
        panel: Controls,
        up: np.ndarray,
        out: Path,
        cameras: Sequence[Camera] = (),
    ) -> None:
        self._drawing, self._panel = drawing, panel
        self._up, self._out, self._cameras = up, out, cameras
        # What each browser was sent last, when it was first wanted (seconds), and whether fine.
        self._shown: dict[int, tuple[Wanted, float, bool]] = {}
        self._keyframes: list[ViewerCamera] = []

    def step(self, browsers: Mapping[int, Page], now: float) -> float:
        """Handle pressed buttons, then update every page whose picture is out of date.

        ``now`` is the time of a monotonic clock, seconds. Returns the seconds until the next step
        is due even if nothing happens.
        """
        state = self._panel.state(now)
        for click in self._panel.clicks():
            browser = browsers.get(click.browser)  # None if it was just closed
            if browser is not None and (view := browser.camera()).usable():
                browser.tell(self._done(click.action, state, view))
        self._shown = {k: shown for k, shown in self._shown.items() if k in browsers}
        pending = False
        for k, browser in browsers.items():
            if (view := browser.camera()).usable():
                pending |= self._serve(k, browser, (state, view, tuple(self._keyframes)), now)
        return TICK if self._panel.playing else REST if pending else 1.0

    def _serve(self, k: int, browser: Page, wanted: Wanted, now: float) -> bool:
        """Update one browser; return whether its fine picture is still to come."""
        shown, since, fine = self._shown.get(k, (None, now, False))
        if shown != wanted:
            browser.show(self.picture(*wanted[:2], fine=False), False)
            since, fine = now, False
        elif not fine and now - since >= REST:
            browser.show(self.picture(*wanted[:2]), True)
            fine = True
        self._shown[k] = wanted, since, fine
        return not fine

    def picture(self, state: State, view: ViewerCamera, fine: bool = True) -> np.ndarray:
        """Draw a browser's picture, 8-bit (H, W, 3): ``fine``, or with few pixels."""
        camera = self._camera(state, view)
        if not fine:
            camera = coarser(camera, COARSE // 2 if self._beside(state) else COARSE)
        picture = self._drawing.picture(state, camera, fine)
        if not self._beside(state):
            return picture
        frame = self._drawing.frame(state, camera.width, camera.height)
        return np.concatenate([frame, picture], axis=1)

    def _beside(self, state: State) -> bool:
        return state.beside and bool(self._cameras)

    def _camera(self, state: State, view: ViewerCamera) -> Camera:
        """Return the camera that the avatar is drawn with."""
        if self._beside(state):
            view = replace(view, width=view.width // 2)
        if state.seen_from == "video" and self._cameras:
            return fitted(self._cameras[state.frame], view.width, view.height)
        if state.seen_from == "keyframes" and self._keyframes:
            cameras = self._film(view)
            return cameras[state.frame % len(cameras)]
        return view.to_camera()

    def _film(self, view: ViewerCamera) -> list[Camera]:
        """Return cameras along the keyframes: one for each frame of the motion, or one for all."""
        frames = len(self._drawing.motion)
        return film(self._keyframes, self._up, frames, view.width, view.height)

    def _done(self, action: Action, state: State, view: ViewerCamera) -> str:
        """Carry out a button's action; return a sentence about the result."""
        if action in ("add keyframe", "remove keyframe"):
            self._keyframes = self._keyframes + [view] if "add" in action else self._keyframes[:-1]
            self._panel.count_keyframes(len(self._keyframes))
            return f"keyframes: {len(self._keyframes)}"
        if action == "save cameras" and not self._keyframes:
            return "there is no keyframe yet: add some"
        name = "snapshot_{:03d}.png" if action == "snapshot" else "cameras_{:03d}.npz"
        path = out = self._out
        try:
            with folder_lock(out, "gva-mi view"):  # another viewer may want the same name
                paths = (out / name.format(number) for number in count())
                path = next(path for path in paths if not path.exists())
                if action == "snapshot":
                    write_image(path, self._snapshot(state, view))
                else:
                    save_cameras(path, self._film(view))
        except InputError as error:
            return str(error)
        except OSError as error:
            return f"{path}: cannot be written ({error.strerror})"
        say(f"saved: {path}")
        return f"saved: {path}"

    def _snapshot(self, state: State, view: ViewerCamera) -> np.ndarray:
        """Return the current picture in full resolution, or the avatar alone as RGBA."""
        if not state.transparent:
            return self.picture(state, view)
        alone = replace(state, beside=False)
        return to_rgba(self._drawing.layer(alone, self._camera(alone, view)))
