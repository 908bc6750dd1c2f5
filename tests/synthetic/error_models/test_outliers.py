"""Outliers affect the given share of frames and no others."""

import numpy as np
import pytest

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND
from gva_mi.synthetic.error_models.outliers import (
    Outliers,
    jumps,
    lose_hands,
    mean_hand,
    swap_legs,
)

FRAMES = 600


@pytest.fixture
def rotations(rng):
    return 0.4 * rng.normal(size=(FRAMES, 55, 3))


def changed(before, after):
    """In which frames, (T,) bool."""
    return (before != after).any((1, 2))


def legs(side):
    return [JOINTS.index(f"{side}_{name}") for name in ("hip", "knee", "ankle", "foot")]


def test_a_lost_hand_is_the_mean_hand(rotations, rng):
    after = rotations.copy()
    lose_hands(after, Outliers(lost=0.2), 1.0, rng)
    for side, hand in (("left", LEFT_HAND), ("right", RIGHT_HAND)):
        lost = changed(rotations[:, hand], after[:, hand])
        assert 0.1 < lost.mean() < 0.3
        assert np.allclose(after[lost][:, hand], mean_hand(side))
        assert not after[lost, JOINTS.index(f"{side}_wrist")].any()


def test_swapped_legs_are_mirrored(rotations, rng):
    after = rotations.copy()
    swap_legs(after, Outliers(swapped=0.2), 1.0, rng)
    where = changed(rotations, after)
    assert 0.1 < where.mean() < 0.3
    for one, other in (("left", "right"), ("right", "left")):
        mirrored = rotations[where][:, legs(other)] * (1, -1, -1)
        assert np.array_equal(after[where][:, legs(one)], mirrored)
    rest = [j for j in range(55) if j not in legs("left") + legs("right")]
    assert np.array_equal(after[:, rest], rotations[:, rest])


def test_a_jump_lasts_and_is_one_displacement(rng):
    moved = jumps(FRAMES, Outliers(jumps=0.2, jump=0.08), 1.0, rng)
    away = moved.any(1)
    assert 0.1 < away.mean() < 0.3
    same = (moved[1:] == moved[:-1]).all(1)
    assert same[away[1:] & away[:-1]].all()  # within a run of frames
    size = np.sqrt((moved[away] ** 2).sum(1).mean())
    assert 0.04 < size < 0.14
    assert moved[away, 2].std() > moved[away, 0].std()  # mostly in depth
