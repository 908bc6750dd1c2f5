"""Draw an open viewer's pictures: one thread, one step after the other.

Other threads only record what browsers and their panel do. A step reads the newest state and draws
it, and skips older ones. It draws few pixels first, and all pixels, as ``gva-mi render`` does, once
nothing has changed for a moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.fit.renders import layer_of, over
from gva_mi.splat import Camera
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.video import Video
from gva_mi.viewer.panel import Panel
from gva_mi.viewer.server import Page, Shapes
from gva_mi.viewer.state import ShownPose, State, ViewerCamera, posed

COARSE_PIXELS = 640 * 360  # while something changes; chosen: many pictures per second on two cores
PAUSE = 0.2  # seconds without a change before all pixels are drawn; chosen: a hand has stopped
PLAYING_STEP = 1 / 60  # seconds between two steps while a motion plays, as screens show
IDLE_STEP = 1.0  # seconds between two steps while nothing happens; chosen: it notices closed pages


Wanted = tuple[State, ViewerCamera]


class Shown(NamedTuple):
    """What a page shows."""

    wanted: Wanted | None  # what was sent last
    since: float  # when it was first wanted, seconds
    fine: bool  # whether all pixels were sent


class Session:
    """Draw one avatar in the panel's state for every open page.

    Args:
        avatar: to be drawn.
        motion: what drives it.
        panel: the controls that all pages share.
        shapes: the surface and the skeleton that browsers draw; None: they are not shown.
        video: the video of the motion's frames; None: it is not shown.
    """

    def __init__(
        self,
        avatar: Avatar,
        motion: Pose,
        panel: Panel,
        shapes: Shapes | None = None,
        video: Video | None = None,
    ) -> None:
        self._avatar, self._motion, self._video = avatar, motion, video
        self._panel, self._shapes = panel, shapes
        self._shown: dict[int, Shown] = {}
        self._posed: tuple[object, ShownPose] | None = None  # the last one, with its pose
        self._last: State | None = None

    def step(self, pages: Mapping[int, Page], now: float) -> float:
        """Update every page whose picture is out of date, and send the pictures to be saved.

        ``now`` is the time of a monotonic clock, seconds. Returns the seconds until the next step
        is due even if nothing happens.
        """
        state = self._panel.state(now)
        if self._shapes is not None and state != self._last:
            self._shapes.show(state, self._pose(state))
        self._last = state
        views = {k: page.camera() for k, page in pages.items()}
        views = {k: view for k, view in views.items() if view.usable()}
        for k in self._panel.saving():
            if k in views:  # its page may just have been closed
                pages[k].save(self.picture(state, views[k]), f"frame_{state.frame:06d}.png")
        self._shown = {k: shown for k, shown in self._shown.items() if k in pages}
        pending = [self._serve(k, pages[k], (state, view), now) for k, view in views.items()]
        if self._panel.playing:
            return PLAYING_STEP
        return PAUSE if any(pending) else IDLE_STEP

    def _serve(self, k: int, page: Page, wanted: Wanted, now: float) -> bool:
        """Update one page; return whether its fine picture is still to come."""
        shown = self._shown.get(k, Shown(None, now, False))
        state, view = wanted
        if shown.wanted != wanted:
            page.show(self.picture(state, view, fine=False), False)
            shown = Shown(wanted, now, False)
        elif not shown.fine and now - shown.since >= PAUSE:
            page.show(self.picture(state, view), True)
            shown = shown._replace(fine=True)
        self._shown[k] = shown
        return not shown.fine

    def picture(self, state: State, view: ViewerCamera, fine: bool = True) -> np.ndarray:
        """Draw a page's picture, 8-bit (H, W, 3): ``fine``, or with few pixels."""
        if state.beside and self._video is not None:
            return self._beside(state, view)
        camera = view.to_camera()
        return self._drawn(state, camera if fine else coarser(camera))

    def _beside(self, state: State, view: ViewerCamera) -> np.ndarray:
        """Draw the video's frame and, on its right, the avatar through the video's camera."""
        from PIL import Image, ImageOps

        frame = in_8_bits(self._video[state.frame].image)
        pair = np.concatenate([frame, self._drawn(state, self._video.cameras[state.frame])], axis=1)
        size = view.width, view.height
        return np.asarray(ImageOps.pad(Image.fromarray(pair), size, color=state.background))

    def _drawn(self, state: State, camera: Camera) -> np.ndarray:
        """Draw the avatar over the background, 8-bit (H, W, 3)."""
        if state.mode == "surface":  # which the browser draws
            return np.full((camera.height, camera.width, 3), state.background, dtype=np.uint8)
        behind = np.array(state.background, dtype=np.float32) / 255
        return over(layer_of(self._pose(state).gaussians, camera), behind)

    def _pose(self, state: State) -> ShownPose:
        """Pose the avatar, unless it is in this pose already."""
        key = state.frame, state.turned, state.expression
        if self._posed is None or self._posed[0] != key:
            self._posed = key, ShownPose.of(self._avatar, posed(self._motion, state))
        return self._posed[1]


def coarser(camera: Camera) -> Camera:
    """Return the same view with few pixels."""
    scale = min(1.0, (COARSE_PIXELS / (camera.width * camera.height)) ** 0.5)
    return camera.resized(max(1, int(camera.width * scale)), max(1, int(camera.height * scale)))
