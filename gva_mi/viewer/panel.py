"""The viewer's panel: sliders, switches and buttons of viser, and the state they define.

All browsers share it. viser's threads keep the values. The thread that draws reads them, and writes
them back while a motion plays or when another joint is chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, get_args

from gva_mi.body.pose import JOINTS
from gva_mi.viewer.state import Angles, Mode, State

if TYPE_CHECKING:
    import viser

FPS = 30  # frames per second at the start, as in exported videos
MAX_FPS = 60  # of the slider; chosen: what screens show
MAX_EXPRESSION = 3.0  # standard deviations of a coefficient, of the slider; chosen: rare faces
ZERO: Angles = (0.0, 0.0, 0.0)


class Panel:
    """The panel of a server.

    Attributes:
        playing: whether the motion plays.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        frames: int,
        joints: Sequence[str],
        expression: Sequence[str],
        video: bool,
        changed: Callable[[], None],
    ) -> None:
        """Build the panel.

        Args:
            gui: viser's, of a server.
            frames: number of frames of the motion.
            joints: names of the joints that can be turned.
            expression: what each coefficient of the expression does.
            video: whether a video can be shown beside the avatar.
            changed: called, in any thread, after a change.
        """
        self._changed, self._frames = changed, frames
        self._saving: SimpleQueue[int] = SimpleQueue()
        self._turned: dict[str, Angles] = {}
        self._joint, self._reset = joints[0], False
        # The time of frame 0, seconds; the frame that was shown last, with the rate.
        self._begun, self._playing = 0.0, None
        self.playing = False
        add = self._watched
        self._mode = add(gui.add_dropdown("show", get_args(Mode)))
        self._background = add(gui.add_rgb("background", (255, 255, 255)))
        self._beside = add(gui.add_checkbox("beside the video", video, visible=video))
        with gui.add_folder("Motion"):
            self._play = add(gui.add_checkbox("play", False, disabled=frames == 1))
            self._frame = add(gui.add_slider("frame", 0, frames - 1, 1, 0))
            self._fps = add(gui.add_slider("frames a second", 1, MAX_FPS, 1, FPS))
        with gui.add_folder("Joints"):
            self._chosen = add(gui.add_dropdown("joint", tuple(joints)))
            about = "degrees about this axis of the joint, added to the motion's rotation"
            slider = lambda axis: gui.add_slider(axis, -180.0, 180.0, 1.0, 0.0, hint=about)
            self._angles = [add(slider(axis)) for axis in "xyz"]
        with gui.add_folder("Expression", expand_by_default=False):
            slider = lambda name: gui.add_slider(name, -MAX_EXPRESSION, MAX_EXPRESSION, 0.1, 0.0)
            self._expression = [add(slider(name)) for name in expression]
        gui.add_button("Reset joints and expression").on_click(self._ask_for_reset)
        gui.add_button("Save picture").on_click(self._ask_for_picture)

    def state(self, now: float) -> State:
        """Return the viewer's state at a time (seconds); a playing motion moves its slider."""
        if self._reset:
            self._reset = False
            self._turned.clear()
            for slider in (*self._angles, *self._expression):
                slider.value = 0.0
        self._read_joint()
        expression = tuple(slider.value for slider in self._expression)
        turned = ((JOINTS.index(joint), angles) for joint, angles in self._turned.items())
        return State(
            frame=self._frame_at(now),
            mode=self._mode.value,
            turned=tuple(sorted(turned)),
            expression=expression if any(expression) else (),
            background=tuple(self._background.value),
            beside=self._beside.value,
        )

    def saving(self) -> Iterator[int]:
        """Yield the browsers that have asked for their picture since the last call."""
        while True:
            try:
                yield self._saving.get_nowait()
            except Empty:
                return

    def _frame_at(self, now: float) -> int:
        """Return the frame to show; a motion plays in a loop by the clock, from the slider on."""
        frame, fps = min(max(self._frame.value, 0), self._frames - 1), self._fps.value
        self.playing = self._play.value and self._frames > 1
        if not self.playing:
            self._playing = None
            return frame
        if self._playing != (frame, fps):  # it begins, or a user moved a slider
            self._begun = now - frame / fps
        frame = int((now - self._begun) * fps + 1e-6) % self._frames
        self._playing, self._frame.value = (frame, fps), frame
        return frame

    def _read_joint(self) -> None:
        """Store the sliders' angles; if the user chose another joint, show its angles."""
        angles = tuple(slider.value for slider in self._angles)
        self._turned.pop(self._joint, None)
        if any(angles):
            self._turned[self._joint] = angles
        if self._chosen.value != self._joint:
            self._joint = self._chosen.value
            angles = self._turned.get(self._joint, ZERO)
            for slider, angle in zip(self._angles, angles, strict=True):
                slider.value = angle

    def _watched(self, handle: Any) -> Any:  # noqa: ANN401 (viser's inputs have no base)
        """Report changes of an input, and return it."""
        handle.on_update(lambda _: self._changed())
        return handle

    def _ask_for_reset(self, event: viser.GuiEvent) -> None:
        self._reset = True
        self._changed()

    def _ask_for_picture(self, event: viser.GuiEvent) -> None:
        self._saving.put(event.client_id)
        self._changed()
