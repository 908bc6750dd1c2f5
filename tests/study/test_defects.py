"""Defects of an outline, of pictures whose defects are known."""

import numpy as np
import pytest

from gva_mi.study.scores import EDGE, flicker, spill_and_holes

SIZE = 40


def square(low, high):
    mask = np.zeros((SIZE, SIZE))
    mask[low:high, low:high] = 1
    return mask


def seen(alpha, color=0.3):
    """An avatar of one colour, on white and on black, as 8-bit pictures."""
    on = lambda ground: alpha[..., None] * color + (1 - alpha[..., None]) * np.full(3, ground)
    return tuple(np.round(255 * on(ground)).astype(np.uint8) for ground in (1.0, 0.0))


def test_a_perfect_render_has_no_defects():
    mask = square(10, 30)
    assert spill_and_holes(*seen(mask), mask) == (0, 0)


@pytest.mark.parametrize("grown", [EDGE, -EDGE])
def test_the_border_does_not_count(grown):
    mask, alpha = square(10, 30), square(10 - grown, 30 + grown)
    assert spill_and_holes(*seen(alpha), mask) == (0, 0)
    alpha = square(10 - 2 * grown, 30 + 2 * grown)
    assert sum(spill_and_holes(*seen(alpha), mask)) > 0.1


@pytest.mark.parametrize(
    "where, alpha, spill, holes",
    [
        ((slice(2, 6), slice(34, 39)), 0.6, 0.6 * 20 / 400, 0),
        ((slice(18, 22), slice(18, 22)), 0.25, 0, 0.75 * 16 / 400),
    ],
    ids=["floater", "hole"],
)
def test_floaters_and_holes_count_by_their_share_of_the_person(where, alpha, spill, holes):
    mask = square(10, 30)
    drawn = mask.copy()
    drawn[where] = alpha
    found = spill_and_holes(*seen(drawn), mask)
    assert found == pytest.approx((spill, holes), rel=0.01)


def test_flicker_measures_change_that_the_person_does_not_show():
    mask = square(10, 30)
    person = (seen(mask)[0], seen(np.roll(mask, 1, axis=1))[0])
    assert flicker(person, person, mask) == 0
    brighter = (seen(mask)[0], seen(np.roll(mask, 1, axis=1), color=0.5)[0])
    assert flicker(brighter, person, mask) == pytest.approx(0.2, abs=0.005)
