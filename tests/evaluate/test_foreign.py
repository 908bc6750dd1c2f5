"""The foreign share is what its equation says, on pictures whose answer is known."""

import numpy as np
import pytest

from gva_mi.evaluate.foreign import foreign_shares

SKIN, CLOTH = 0, 1
COLORS = np.array([[200, 150, 120], [30, 60, 110]])


@pytest.fixture
def scene():
    """Skin on the left, which is an arm, and cloth on the right: picture, materials, arms."""
    material = np.where(np.arange(80) < 40, SKIN, CLOTH) * np.ones((60, 1), int)
    noise = np.random.default_rng(0).normal(0, 5, (60, 80, 3))
    picture = np.clip(COLORS[material] + noise, 0, 255).astype(np.uint8)
    return picture, material, material == SKIN


def test_a_share_of_the_arm_in_the_colors_of_cloth_is_foreign(scene):
    picture, material, arms = scene
    render = picture.copy()
    rows = slice(10, 20)  # of 56 that lie inside, from 2 to 58
    render[rows, :40] = picture[rows, 40:]
    shares = foreign_shares([picture], [(render, arms.astype(float))], [(material, arms)])
    assert shares == {"arms": pytest.approx(10 / 56), "rest": 0}


def test_no_pixel_of_the_truth_and_none_of_a_darker_picture_is_foreign(scene):
    picture, material, arms = scene
    for render in (picture, (0.9 * picture).astype(np.uint8)):
        found = foreign_shares([picture], [(render, arms.astype(float))], [(material, arms)])
        assert found == {"arms": 0, "rest": 0}


def test_where_the_avatar_draws_another_part_or_nothing_its_pose_is_off(scene):
    picture, material, arms = scene
    render = picture[:, ::-1]  # all colours are of the other material
    drawn = np.where(np.arange(80) < 20, 1.0, np.where(np.arange(80) < 40, 0.0, np.nan))
    shares = foreign_shares([picture], [(render, drawn * np.ones((60, 1)))], [(material, arms)])
    assert shares == {"arms": 1}


def test_without_two_materials_there_is_no_share(scene):
    picture, material, arms = scene
    assert foreign_shares([picture], [(picture, arms * 1.0)], [(material * 0, arms)]) == {}
