"""The drawing loop: only the newest state, coarse first, and then the bits of ``render``."""

from dataclasses import replace

import numpy as np
import pytest

from gva_mi.fit.renders import over, render_layer
from gva_mi.viewer.session import COARSE_PIXELS, PAUSE, Session
from gva_mi.viewer.state import State


@pytest.fixture
def opened(known, motion, panel):
    return Session(known, motion, panel)


def rendered(avatar, pose, view):
    return over(render_layer(avatar, pose, view.to_camera()), np.ones(3, "f4"))


def test_a_picture_is_coarse_first_and_then_as_rendered(known, motion, opened, panel, page):
    page.at = replace(page.at, width=900, height=600)  # more pixels than while something moves
    panel.now = State(frame=2)
    assert opened.step({7: page}, 0.0) == PAUSE
    assert opened.step({7: page}, PAUSE / 2) == PAUSE
    panel.asking = [7, 8]  # the second has been closed
    assert opened.step({7: page}, PAUSE) > PAUSE
    panel.asking = []
    opened.step({7: page}, 2 * PAUSE)
    (coarse, first), (whole, second) = page.shown  # and nothing twice
    assert not first and second
    assert coarse.shape[0] * coarse.shape[1] <= COARSE_PIXELS and coarse.shape[0] / 600 > 0.5
    ((saved, name),) = page.saved
    for found in (whole, saved):
        assert np.array_equal(found, rendered(known, motion[2], page.at))
    assert name == "frame_000002.png"


def test_a_moving_browser_waits_for_its_fine_picture(opened, page, place, looking):
    opened.step({7: page}, 0.0)
    page.at = looking(place.position + 0.2 * place.up)
    opened.step({7: page}, 0.9 * PAUSE)
    opened.step({7: page}, 1.5 * PAUSE)
    assert [fine for _, fine in page.shown] == [False, False]
    opened.step({7: page}, 2 * PAUSE)
    assert page.shown[-1][1] and np.array_equal(page.shown[-1][0], page.shown[1][0])


def test_each_browser_has_its_own_view_and_may_leave(opened, page):
    other, hidden = (type(page)(replace(page.at, width=width)) for width in (40, 0))
    opened.step({1: page, 2: other}, 0.0)
    opened.step({2: other, 3: hidden}, 1.0)
    assert len(page.shown) == 1 and [fine for _, fine in other.shown] == [False, True]
    assert other.shown[1][0].shape == (64, 40, 3) and not hidden.shown


def test_every_frame_and_a_turned_joint_change_the_picture(known, motion, opened, page):
    for k in (2, 0, 3, 3):
        found = opened.picture(State(frame=k), page.at)
        assert np.array_equal(found, rendered(known, motion[k], page.at))
    turned = opened.picture(State(frame=3, turned=((16, (0.0, 0.0, 40.0)),)), page.at)
    assert (np.abs(turned.astype(int) - found) > 20).sum() > 20
    surface = opened.picture(State(mode="surface", background=(1, 2, 3)), page.at)
    assert (surface == (1, 2, 3)).all()  # the browser draws it


def test_beside_the_video_through_its_camera(known, video, panel, page):
    opened = Session(known, video.pose, panel, None, video)
    page.at = replace(page.at, width=100, height=48)
    panel.now = State(frame=5, beside=True, background=(77, 77, 77))
    opened.step({7: page}, 0.0)
    picture = page.shown[0][0]
    assert picture.shape == (48, 100, 3) and (picture[:, :2] == 77).all()
    left, right = np.split(picture[:, 2:98].astype(int), 2, axis=1)
    # The subject's pictures show this avatar in front of a grey of 0.3.
    assert np.abs(left - right).max() <= 2
