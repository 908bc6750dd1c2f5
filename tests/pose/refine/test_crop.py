"""The box around a person, and the image on a coarser grid inside it."""

import numpy as np
import pytest

from gva_mi.splat import Camera, look_at
from gva_mi.subject.crop import Box, NoEvidence, ScaledCrop, person_extent

CAMERA = Camera(100, 100, 50, 40, look_at((0, 0, 5), (0, 0, 0)), 100, 80)


def mask(rows, columns):
    found = np.zeros((80, 100), np.float32)
    found[slice(*rows), slice(*columns)] = 1
    return found


MASK = mask((30, 50), (40, 60))


def at(*pixels):
    """Points that project to some pixels (x, y)."""
    return np.array([[(x - 50) / 20, (40 - y) / 20, 0.0] for x, y in pixels])


def box_around(mask, points, margin):
    extent = person_extent(mask, CAMERA, points, "it")
    return extent.box(margin, np.array([CAMERA.width, CAMERA.height]))


def edges(box):
    return box.left, box.top, box.right, box.bottom


def test_the_box_contains_mask_points_and_margin_and_ends_with_the_image():
    assert edges(box_around(MASK, at((70.5, 45)), 0.1)) == (36, 26, 74, 54)
    wide = mask((0, 80), (90, 100)), at((200, -30), (95, 40)), 1
    assert edges(box_around(*wide)) == (0, 0, 100, 80)


@pytest.mark.parametrize(("mask", "points", "sentence"),
    [(MASK, at((150, 40)), "its avatar is out of view"),
    (MASK, np.array([[0.0, 0, 6]]), "its avatar reaches behind the camera"),
    (mask((0, 3), (0, 5)), at((50, 40)), "its mask is empty")])  # fmt: skip
def test_frames_that_show_nothing_say_why(mask, points, sentence):
    with pytest.raises(NoEvidence, match=sentence):
        person_extent(mask, CAMERA, points, "its avatar")


def coarser(picture, crop):
    part = crop.cover(*picture.shape[:2])
    return crop.shrink(picture[part], part)


@pytest.mark.parametrize(("times", "ratio"), [(1, 1), (1, 3), (3, 5), (4, 13)])
def test_pixels_count_by_the_part_that_a_coarser_one_covers(times, ratio):
    """Shrinking by times / ratio is repeating pixels, and then taking whole means."""
    picture = np.random.default_rng(2).random((52, 60, 3))
    finer = picture.repeat(times, 0).repeat(times, 1)
    box = Box(2, 1, 18, 16)
    finer = finer[ratio * box.top : ratio * box.bottom, ratio * box.left : ratio * box.right]
    means = finer.reshape(box.height, ratio, box.width, ratio, 3).mean((1, 3))
    found = coarser(picture, ScaledCrop(times / ratio, box))
    np.testing.assert_allclose(found, means, atol=1e-12)
