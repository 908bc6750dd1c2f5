"""The panel of a real server without a browser; setting a value stands for moving a slider."""

import sys

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.body.pose import JOINTS
from gva_mi.viewer.cameras import Start
from gva_mi.viewer.controls import Choices, Click, Controls
from gva_mi.viewer.server import serving

START = Start(np.array([0.0, 1, 4]), np.array([0.0, 1, 0]), np.array([0.0, 1, 0]), 0.5)
ELBOW, SHOULDER = JOINTS.index("left_elbow"), JOINTS.index("left_shoulder")


@pytest.fixture(scope="module")
def server():
    pytest.importorskip("viser", reason="viser is not installed: pip install 'gva_mi[viewer]'")
    with serving("127.0.0.1", 0, START, "a test") as server:
        yield server


@pytest.fixture
def changes():
    return []


@pytest.fixture
def controls(server, changes):
    choices = Choices(9, ("pelvis", "left_shoulder", "left_elbow"), ("smile", "blink"), False)
    yield Controls(server.gui, choices, lambda: changes.append(1))
    server.gui.reset()


def inputs(server):
    """The panel's inputs by their labels."""
    return {h.label: h for h in server.gui._gui_input_handle_from_uuid.values()}


def press(server, label):
    """A button of browser 7."""
    from viser import GuiEvent

    (button,) = (h for name, h in inputs(server).items() if name.startswith(label))
    for pressed in button._impl.update_cb:
        pressed(GuiEvent(None, 7, button))


def test_sliders_belong_to_the_chosen_joint(server, controls, changes):
    panel = inputs(server)
    panel["joint"].value = "left_shoulder"
    assert controls.state(0.0).joint == SHOULDER
    panel["z"].value = 40.0
    assert controls.state(0.0).turned == ((SHOULDER, (0.0, 0.0, 40.0)),)
    panel["joint"].value = "left_elbow"
    controls.state(0.0)
    assert panel["z"].value == 0.0
    panel["x"].value = -90.0
    both = ((SHOULDER, (0.0, 0.0, 40.0)), (ELBOW, (-90.0, 0.0, 0.0)))
    assert controls.state(0.0).turned == both
    panel["joint"].value = "left_shoulder"
    controls.state(0.0)
    assert panel["z"].value == 40.0 and len(changes) >= 5
    press(server, "Reset joint")
    assert not list(controls.clicks())
    assert controls.state(0.0).turned == both[1:]
    press(server, "Reset all joints")
    assert not list(controls.clicks())
    assert controls.state(0.0).turned == ()


def test_expressions_and_the_rest_of_the_panel(server, controls):
    panel = inputs(server)
    assert controls.state(0.0).expression == ()
    panel["blink"].value = 1.5
    panel["show"].value, panel["background"].value = "normals", (1, 2, 3)
    panel["transparent"].value, panel["frame"].value = True, 5
    state = controls.state(0.0)
    assert state.expression == (0.0, 1.5) and state.frame == 5
    assert (state.mode, state.background, state.transparent) == ("normals", (1, 2, 3), True)
    assert state.seen_from == "browser" and not state.beside
    press(server, "Reset expression")
    list(controls.clicks())
    assert controls.state(0.0).expression == ()


def test_pressed_buttons_are_queued_with_their_browser(server, controls):
    press(server, "Snapshot")
    press(server, "Add keyframe")
    assert list(controls.clicks()) == [Click("snapshot", 7), Click("add keyframe", 7)]
    assert not list(controls.clicks())
    controls.count_keyframes(3)
    assert any("(keyframes: 3)" in name for name in inputs(server))


def test_an_unusable_address_is_one_sentence(server):
    for host, port in (("127.0.0.1", server.get_port()), ("203.0.113.9", 0), ("127.0.0.1", 10**6)):
        with pytest.raises(InputError, match=f"view: cannot listen at {host}, port {port}"):
            serving(host, port, START, "a test").__enter__()


def test_a_missing_viser_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r"viser is not installed: pip install 'gva_mi\[viewer\]'"):
        serving("127.0.0.1", 0, START, "a test").__enter__()
