"""The panel of a real server without a browser; setting a value stands for moving a slider."""

import sys

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.body.pose import JOINTS
from gva_mi.viewer.panel import Panel
from gva_mi.viewer.server import Shapes, serving
from gva_mi.viewer.state import ShownPose, Start, State

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
def panel(server, changes):
    joints, expression = ("pelvis", "left_shoulder", "left_elbow"), ("smile", "blink")
    yield Panel(server.gui, 40, joints, expression, False, lambda: changes.append(1))
    server.gui.reset()


def inputs(server):
    """The panel's inputs by their labels."""
    return {h.label: h for h in server.gui._gui_input_handle_from_uuid.values()}


def press(server, label):
    """A button of browser 7."""
    from viser import GuiEvent

    button = inputs(server)[label]
    for pressed in button._impl.update_cb:
        pressed(GuiEvent(None, 7, button))


def test_sliders_belong_to_the_chosen_joint(server, panel, changes):
    found = inputs(server)
    found["joint"].value = "left_shoulder"
    assert panel.state(0.0).turned == ()
    found["z"].value = 40.0
    assert panel.state(0.0).turned == ((SHOULDER, (0.0, 0.0, 40.0)),)
    found["joint"].value = "left_elbow"
    panel.state(0.0)
    assert found["z"].value == 0.0
    found["x"].value, found["blink"].value = -90.0, 1.5
    both = ((SHOULDER, (0.0, 0.0, 40.0)), (ELBOW, (-90.0, 0.0, 0.0)))
    assert panel.state(0.0).turned == both and panel.state(0.0).expression == (0.0, 1.5)
    found["joint"].value = "left_shoulder"
    panel.state(0.0)
    assert found["z"].value == 40.0 and len(changes) >= 5
    press(server, "Reset joints and expression")
    found["show"].value, found["background"].value, found["frame"].value = "surface", (1, 2, 3), 5
    assert panel.state(0.0) == State(5, "surface", background=(1, 2, 3))


def test_a_picture_is_saved_by_the_browser_that_asks(server, panel):
    press(server, "Save picture")
    assert list(panel.saving()) == [7] and not list(panel.saving())


def test_a_motion_plays_by_the_clock(server, panel):
    """However often it is drawn; from the frame that somebody chooses on."""
    found = inputs(server)
    for steps in (range(1, 101), (1, 100)):
        found["play"].value, found["frame"].value = False, 3
        panel.state(9.0)
        found["play"].value = True
        frames = [panel.state(10 + k * 0.013).frame for k in steps]
        assert frames[0] == 3 and frames[-1] == found["frame"].value
        assert frames[-1] == (3 + int(99 * 0.013 * 30)) % 40 and panel.playing


def test_browsers_draw_the_surface_or_the_bones(server, known, motion):
    shapes, pose = Shapes(server.scene, known.rig), ShownPose.of(known, motion[1])
    for state, visible in (
        (State(mode="surface"), (True, False)), (State(mode="skeleton"), (False, True)),
        (State(), (False, False)), (State(mode="surface", beside=True), (False, False)),
    ):  # fmt: skip
        shapes.show(state, pose)
        assert (shapes._mesh.visible, shapes._lines.visible) == visible
    assert np.array_equal(shapes._mesh.vertices, pose.vertices)
    knee = JOINTS.index("left_knee")
    assert np.isclose(shapes._lines.points, pose.joints[knee]).all(-1).any()


def test_a_server_that_cannot_be_is_one_sentence(server, monkeypatch):
    for host, port in (("127.0.0.1", server.get_port()), ("203.0.113.9", 0), ("127.0.0.1", 10**6)):
        with pytest.raises(InputError, match=f"view: cannot listen at {host}, port {port}"):
            serving(host, port, START, "a test").__enter__()
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r"viser is not installed: pip install 'gva_mi\[viewer\]'"):
        serving("127.0.0.1", 0, START, "a test").__enter__()
