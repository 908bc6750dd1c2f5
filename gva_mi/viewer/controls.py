"""The viewer's panel: sliders, switches and buttons of viser, and the state they define.

All browsers share it. viser's threads keep the values. The thread that draws reads them, and writes
them back while a motion plays or when another joint is chosen. Pressed buttons are queued.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

from gva_mi.body.pose import JOINTS
from gva_mi.viewer.state import Angles, Mode, Playback, SeenFrom, State

if TYPE_CHECKING:
    import viser

FPS = 30  # frames a second, as films are exported
FASTEST = 60
WIDEST = 3.0  # expression coefficients, standard deviations
ZERO: Angles = (0.0, 0.0, 0.0)
Action = Literal["snapshot", "add keyframe", "remove keyframe", "save cameras"]
RESETS = ("reset joint", "reset all joints", "reset expression")


class Click(NamedTuple):
    """A pressed button."""

    action: Action
    browser: int  # where it was pressed


@dataclass(frozen=True)
class Choices:
    """Choices that an avatar, its motion and its video offer in the panel."""

    frames: int
    joints: Sequence[str]  # some of JOINTS
    expression: Sequence[str]  # what each coefficient does
    video: bool  # whether a video is shown beside


class Controls:
    """The panel of a server.

    Attributes:
        playing: whether the motion plays.
    """

    def __init__(self, gui: viser.GuiApi, choices: Choices, changed: Callable[[], None]) -> None:
        """Build the panel in ``gui``; ``changed`` is called, in any thread, after a change."""
        self._gui, self._changed, self._last = gui, changed, choices.frames - 1
        self._clicked: SimpleQueue[tuple[str, int]] = SimpleQueue()
        self._turned: dict[str, Angles] = {}
        self._joint = choices.joints[0]
        self._playback = Playback()
        self.playing = False
        add = self._watched
        self._mode = add(gui.add_dropdown("show", get_args(Mode)))
        self._background = add(gui.add_rgb("background", (255, 255, 255)))
        with gui.add_folder("Motion"):
            self._play = add(gui.add_checkbox("play", False, disabled=self._last == 0))
            self._frame = add(gui.add_slider("frame", 0, self._last, 1, 0))
            self._fps = add(gui.add_slider("frames a second", 1, FASTEST, 1, FPS))
        with gui.add_folder("Joints"):
            self._chosen = add(gui.add_dropdown("joint", tuple(choices.joints)))
            about = "degrees about this axis of the joint, added to the motion's rotation"
            self._angles = [
                add(gui.add_slider(axis, -180.0, 180.0, 1.0, 0.0, hint=about)) for axis in "xyz"
            ]
            self._add_button("reset joint", "Reset joint")
            self._add_button("reset all joints", "Reset all joints")
        with gui.add_folder("Expression", expand_by_default=False):
            self._expression = [
                add(gui.add_slider(name, -WIDEST, WIDEST, 0.1, 0.0)) for name in choices.expression
            ]
            self._add_button("reset expression", "Reset expression")
        with gui.add_folder("Camera"):
            self._add_camera(choices.video)

    def _add_camera(self, video: bool) -> None:
        gui, add = self._gui, self._watched
        places = tuple(x for x in get_args(SeenFrom) if video or x != "video")
        first, about = places[-1 if video else 0], "browser: turn, zoom and move by the mouse"
        self._seen_from = add(
            gui.add_dropdown("seen from", places, initial_value=first, hint=about)
        )
        self._beside = add(gui.add_checkbox("beside the video", video, visible=video))
        about = "snapshots are RGBA, of the avatar alone"
        self._transparent = add(gui.add_checkbox("transparent", False, hint=about))
        self._add_button("snapshot", "Snapshot to PNG")
        self._add_button("add keyframe", "Add keyframe")
        self._add_button("remove keyframe", "Remove last keyframe")
        self._save = self._add_button("save cameras", "Save cameras.npz")

    def state(self, now: float) -> State:
        """Return the viewer's state at a time (seconds); a playing motion moves its slider."""
        frame = min(max(self._frame.value, 0), self._last)
        self.playing = self._play.value and self._last > 0
        if self.playing:
            frame = self._playback.advance(frame, now, self._fps.value, self._last + 1)
            self._frame.value = frame
        else:
            self._playback.stop()
        self._read_joint()
        turned = ((JOINTS.index(joint), angles) for joint, angles in self._turned.items())
        expression = tuple(slider.value for slider in self._expression)
        return State(
            frame=frame,
            mode=self._mode.value,
            turned=tuple(sorted(turned)),
            joint=JOINTS.index(self._joint),
            expression=expression if any(expression) else (),
            background=tuple(self._background.value),
            seen_from=self._seen_from.value,
            beside=self._beside.value,
            transparent=self._transparent.value,
        )

    def clicks(self) -> Iterator[Click]:
        """Yield buttons pressed since the last call; those that reset sliders are done here."""
        while True:
            try:
                action, browser = self._clicked.get_nowait()
            except Empty:
                return
            if action == "reset expression":
                for slider in self._expression:
                    slider.value = 0.0
            elif action in RESETS:
                if action == "reset all joints":
                    self._turned.clear()
                self._set_angles(ZERO)
                self._read_joint()
            else:
                yield Click(action, browser)

    def count_keyframes(self, count: int) -> None:
        """Show the number of keyframes."""
        self._save.label = f"Save cameras.npz (keyframes: {count})"

    def _read_joint(self) -> None:
        """Store the sliders' angles; if the user chose another joint, show its angles."""
        chosen = self._chosen.value
        angles = tuple(slider.value for slider in self._angles)
        self._turned.pop(self._joint, None)
        if any(angles):
            self._turned[self._joint] = angles
        if chosen != self._joint:
            self._joint = chosen
            self._set_angles(self._turned.get(chosen, ZERO))

    def _set_angles(self, angles: Angles) -> None:
        for slider, angle in zip(self._angles, angles, strict=True):
            slider.value = angle

    def _watched(self, handle: Any) -> Any:  # noqa: ANN401 (viser's inputs have no base)
        """Report changes of an input, and return it."""
        handle.on_update(lambda _: self._changed())
        return handle

    def _add_button(self, action: Action | str, label: str) -> viser.GuiButtonHandle:
        button = self._gui.add_button(label)

        @button.on_click
        def _(event: viser.GuiEvent) -> None:
            self._clicked.put((action, event.client_id))
            self._changed()

        return button
