"""The box around a person."""

import numpy as np
import pytest

from gva_mi.pose.crop import NoEvidence, person_box
from gva_mi.splat import Camera, look_at

CAMERA = Camera(100, 100, 50, 40, look_at((0, 0, 5), (0, 0, 0)), 100, 80)


def mask(rows, columns):
    found = np.zeros((80, 100), np.float32)
    found[rows, columns] = 1
    return found


def at(*pixels):
    """Points that are seen at some pixels (x, y)."""
    return np.array([[(x - 50) / 20, (40 - y) / 20, 0.0] for x, y in pixels])


def test_the_box_holds_the_mask_and_the_points_and_a_margin():
    box = person_box(mask(slice(30, 50), slice(40, 60)), CAMERA, at((70.5, 45)), 0.1, "it")
    assert (box.left, box.top, box.right, box.bottom) == (36, 26, 74, 54)
    assert (box.width, box.height) == (38, 28)


def test_what_is_cut_is_seen_by_the_camera_that_is_cut():
    points = at((41, 31), (66, 47))
    box = person_box(mask(slice(30, 50), slice(40, 60)), CAMERA, points, 0.2, "it")
    picture = np.random.default_rng(0).random((80, 100, 3))
    camera = box.cut_camera(CAMERA)
    assert box.cut(picture).shape[:2] == (camera.height, camera.width)
    moved = CAMERA.project(points) - camera.project(points)
    np.testing.assert_allclose(moved, [[box.left, box.top]] * 2, atol=1e-9)
    assert box.cut(picture)[0, 0, 0] == picture[box.top, box.left, 0]


def test_the_box_stays_inside_the_picture():
    box = person_box(mask(slice(0, 80), slice(90, 100)), CAMERA, at((200, -30), (95, 40)), 1, "it")
    assert (box.left, box.top, box.right, box.bottom) == (0, 0, 100, 80)


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (at((150, 40)), "its avatar is out of view"),
        (np.array([[0.0, 0, 6]]), "its avatar reaches behind the camera"),
    ],
)
def test_points_that_are_not_seen_are_no_evidence(points, sentence):
    with pytest.raises(NoEvidence, match=sentence):
        person_box(mask(slice(30, 50), slice(40, 60)), CAMERA, points, 0.1, "its avatar")


def test_a_few_pixels_are_an_empty_mask():
    with pytest.raises(NoEvidence, match="its mask is empty"):
        person_box(mask(slice(0, 3), slice(0, 5)), CAMERA, at((50, 40)), 0.1, "it")
