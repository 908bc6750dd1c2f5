"""What the tests of the viewer share: a known avatar, its motion, plain panels and pages."""

import pytest

from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.eyes import Eye, start
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
    """A browser that looks at the person from somewhere."""
    import roma
    import torch

    from gva_mi.splat import look_at

    def eye(position, width=80, height=64):
        R = torch.from_numpy(look_at(position, place.look_at, place.up)[:3, :3].T.copy())
        x, y, z, w = roma.rotmat_to_unitquat(R).tolist()
        at = tuple(map(float, position)), tuple(map(float, place.look_at))
        return Eye(*at, (w, x, y, z), place.fov, width, height)

    return eye


@pytest.fixture
def eye(place, looking):
    """A browser that has not been touched."""
    return looking(place.position)


@pytest.fixture
def panel():
    return PlainPanel()


@pytest.fixture
def page(eye):
    return PlainPage(eye)


class PlainPanel:
    """A panel whose state is set by hand."""

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
    """A page that keeps what it is shown and told."""

    def __init__(self, eye):
        self.at, self.shown, self.told = eye, [], []

    def eye(self):
        return self.at

    def show(self, picture, fine):
        self.shown.append((picture, fine))

    def tell(self, sentence):
        self.told.append(sentence)
