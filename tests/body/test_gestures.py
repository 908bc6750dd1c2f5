"""Hand gestures: mirrored, blended smoothly, with fingertips in place."""

import numpy as np
import pytest
import torch

from gva_mi.body import gestures
from gva_mi.body.gestures import FINGERS, GESTURES
from gva_mi.body.pose import JOINTS, Pose, Shape


def rotations(name, side="left"):
    shaped = np.zeros((1, 55, 3))
    gestures.put_hand(shaped, side, GESTURES[name].values)
    return shaped


@pytest.fixture(scope="module")
def hand(body):
    """Return a function from a gesture to the left hand's vertices by joint."""
    owner = body.weights.argmax(1)

    def shaped(name):
        pose = Pose.rest(1)
        pose.rotations[:] = torch.from_numpy(rotations(name))
        vertices = body(pose, Shape(torch.zeros(10))).vertices[0].numpy()
        of = lambda joint: vertices[(owner == JOINTS.index(f"left_{joint}")).numpy()]
        return {joint: of(joint) for joint in (*(f"{f}3" for f in FINGERS), "thumb3")}

    return shaped


def apart(a, b):
    """Return the smallest distance between two point sets, metres."""
    return np.linalg.norm(a[:, None] - b[None], axis=-1).min()


def test_the_right_hand_mirrors_the_left():
    for name in GESTURES:
        left, right = rotations(name, "left")[0], rotations(name, "right")[0]
        assert np.allclose(left[25:40] * [1, -1, -1], right[40:55])
        assert not left[40:].any() and not left[:25].any()


def test_a_pinch_brings_thumb_and_index_together(hand):
    assert apart(hand("pinch")["thumb3"], hand("pinch")["index3"]) < 0.008
    assert apart(hand("rest")["thumb3"], hand("rest")["index3"]) > 0.02


@pytest.mark.parametrize("name, count", [("point", 1), ("two", 2), ("three", 3), ("four", 4)])
def test_counting_gestures_stretch_that_many_fingers(hand, name, count):
    tips, flat = hand(name), hand("open")
    stretched = [tips[f"{f}3"][:, 0].max() > flat[f"{f}3"][:, 0].max() - 0.02 for f in FINGERS]
    assert stretched == [True] * count + [False] * (4 - count)
