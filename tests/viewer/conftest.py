"""Fixtures of the viewer's tests: a known avatar's motion, plain panels and pages."""

import pytest

from gva_mi.viewer.state import State, ViewerCamera, start


@pytest.fixture(scope="session")
def motion(turning):
    return turning(4)[0]


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
        return ViewerCamera(tuple(map(float, position)), (w, x, y, z), place.fov, width, height)

    return view


class PlainPanel:
    """A panel whose state tests set."""

    def __init__(self):
        self.now, self.playing, self.asking = State(), False, []

    def state(self, now):
        return self.now

    def saving(self):
        return iter(self.asking)


class PlainPage:
    """A page that records what it is sent."""

    def __init__(self, view):
        self.at, self.shown, self.saved = view, [], []

    def camera(self):
        return self.at

    def show(self, picture, fine):
        self.shown.append((picture, fine))

    def save(self, picture, name):
        self.saved.append((picture, name))


@pytest.fixture
def panel():
    return PlainPanel()


@pytest.fixture
def page(place, looking):
    return PlainPage(looking(place.position))
