"""Fixtures of the viewer's tests: a known avatar, its motion, plain panels and pages."""

import pytest

from gva_mi.viewer.cameras import ViewerCamera, start
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.state import State


@pytest.fixture(scope="session")
def motion(turning):
    return turning(4)[0]


@pytest.fixture(scope="session")
def drawing(known, motion):
    return Drawing(known, motion)


@pytest.fixture(scope="session")
def place(known, motion):
    return start(known.rig, motion)


@pytest.fixture
def looking(place):
    """Return a function that makes a browser's view of the person from a position."""
    import roma
    import torch

    from gva_mi.splat import look_at

    def view(position, width=80, height=64):
        R = torch.from_numpy(look_at(position, place.look_at, place.up)[:3, :3].T.copy())
        x, y, z, w = roma.rotmat_to_unitquat(R).tolist()
        at = tuple(map(float, position)), tuple(map(float, place.look_at))
        return ViewerCamera(*at, (w, x, y, z), place.fov, width, height)

    return view


@pytest.fixture
def view(place, looking):
    """The first view of a browser."""
    return looking(place.position)


@pytest.fixture
def panel():
    return PlainPanel()


@pytest.fixture
def page(view):
    return PlainPage(view)


class PlainPanel:
    """A panel whose state tests set."""

    def __init__(self):
        self.now, self.playing, self.pressed, self.keyframes = State(), False, [], 0

    def state(self, now):
        return self.now

    def clicks(self):
        pressed, self.pressed = self.pressed, []
        return iter(pressed)

    def count_keyframes(self, count):
        self.keyframes = count


class PlainPage:
    """A page that records what it is sent."""

    def __init__(self, view):
        self.at, self.shown, self.messages = view, [], []

    def camera(self):
        return self.at

    def show(self, picture, fine):
        self.shown.append((picture, fine))

    def tell(self, sentence):
        self.messages.append(sentence)
