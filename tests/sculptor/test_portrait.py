import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import numpy as np
import pytest

from gva_mi.body import load_body
from gva_mi.body.pose import JOINTS
from gva_mi.body.puppet import EXPRESSIONS
from gva_mi.sculptor import portrait
from gva_mi.sculptor.portrait import turntable
from gva_mi.sculptor.portrait_poses import BODIES, faces, hands


@pytest.fixture(scope="module")
def puppet():
    return load_body()


def test_a_turntable_shows_the_body_from_all_sides(puppet):
    image = turntable(puppet, views=2, size=32, samples=4)
    assert image.shape == (32, 46, 3) and 0 <= image.min() and image.max() <= 1
    front, back = image[:, :23], image[:, 23:]
    background = image[0, 0]
    shown = [(np.abs(half - background).max(-1) > 0.1) for half in (front, back)]
    assert all(0.05 < s.mean() < 0.6 for s in shown)
    assert not np.array_equal(front, back)


def test_the_same_picture_twice(puppet):
    draw = lambda: turntable(puppet, views=1, size=24, samples=2)
    np.testing.assert_array_equal(draw(), draw())


def test_the_sheet_names_joints_and_expressions_that_exist(puppet):
    assert len(BODIES) >= 8
    for shown in (*BODIES, *hands(puppet), *faces(puppet)):
        assert set(shown.rotations) <= set(JOINTS)
        assert shown.expression in ("", *EXPRESSIONS)


def test_the_eyes_have_their_own_colours(puppet):
    color = portrait._colors(puppet)
    for side in ("left", "right"):
        eye = (puppet.weights[:, JOINTS.index(f"{side}_eye_smplhf")] > 0.5).numpy()
        assert not (color[eye] == np.float32(portrait.SKIN)).all(1).any()
        assert (color[eye] == np.float32(portrait.IRIS)).all(1).any()
