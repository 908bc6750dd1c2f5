"""The box around a person, and the picture on a coarser grid inside it."""

import numpy as np
import pytest
import torch

from gva_mi.pose.crop import Box, ScaledCrop, Extent, NoEvidence, person_box
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


def coarser(picture, crop):
    part = crop.cover(*picture.shape[:2])
    return crop.shrink(picture[part], part)


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_cutting_and_shrinking_change_places_where_the_ratio_is_whole(ratio):
    picture = np.random.default_rng(1).random((24 * ratio, 30 * ratio, 3))
    shrunk = picture.reshape(24, ratio, 30, ratio, 3).mean((1, 3))
    box = Box(4, 5, 21, 24)
    np.testing.assert_allclose(coarser(picture, ScaledCrop(1 / ratio, box)), box.cut(shrunk), atol=1e-12)


@pytest.mark.parametrize(("times", "ratio"), [(3, 5), (5, 6), (4, 13)])
def test_pixels_that_lie_in_a_coarser_one_partly_count_by_that_part(times, ratio):
    """Shrinking by a ratio of whole numbers is repeating pixels, and then taking whole means."""
    picture = np.random.default_rng(2).random((52, 60, 3))
    finer = picture.repeat(times, 0).repeat(times, 1)
    box = Box(2, 1, 18, 16)
    finer = finer[ratio * box.top : ratio * box.bottom, ratio * box.left : ratio * box.right]
    means = finer.reshape(box.height, ratio, box.width, ratio, 3).mean((1, 3))
    np.testing.assert_allclose(coarser(picture, ScaledCrop(times / ratio, box)), means, atol=1e-12)


def test_a_crop_ends_where_the_picture_ends():
    crop = ScaledCrop.around(Extent(np.array([80.0, 60]), np.array([120.0, 80])), CAMERA, 0.33, 0.2)
    assert (crop.box.right, crop.box.bottom) == (33, 26)  # 33 and 26.4 pixels
    assert coarser(np.ones((80, 100)), crop).shape == (crop.box.height, crop.box.width)
    assert torch.allclose(coarser(np.ones((80, 100)), crop), torch.tensor(1.0, dtype=torch.float64))


def test_a_body_s_shrunken_mask_is_the_mask_of_the_shrunken_camera(body, scene):
    """The mean outline of the one and that of the other differ by less than a tenth of a pixel."""
    up = (0.3, 1, 0)  # so that no outline runs along the pixels
    fine = Camera(400, 420, 250.4, 260.2, look_at((0.2, 0.1, 3), (0, -0.1, 0), up), 480, 520)
    extent = Extent(np.array([120.0, 40]), np.array([380.0, 500]))
    crop = ScaledCrop.around(extent, fine, 0.37, 0.1)
    with torch.no_grad():
        shrunk = coarser(scene.render(body.v_template, fine)[..., 3].numpy(), crop)
        seen = scene.render(body.v_template, crop.cut_camera(fine))[..., 3]
    assert seen.shape == shrunk.shape
    outline = float((shrunk[:, 1:] - shrunk[:, :-1]).abs().sum())  # pixels, by its height
    assert abs(float((seen - shrunk).sum())) / outline < 0.1  # it is not wider,
    for axis in (0, 1):  # and it is not moved
        place = torch.arange(shrunk.shape[axis])
        means = [(x.sum(1 - axis) * place).sum() / x.sum() for x in (seen, shrunk)]
        assert abs(float(means[0] - means[1])) < 0.1
