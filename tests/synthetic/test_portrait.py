"""Pictures of a bare body."""

import numpy as np
import pytest

from gva_mi.synthetic.portrait import pose_sheet, turntable

pytest.importorskip("mitsuba")


def test_a_turntable_shows_the_body_from_all_sides_with_the_same_bits(body):
    image, again = (turntable(body, views=2, size=32, samples=4) for _ in range(2))
    assert image.shape == (32, 44, 3) and np.array_equal(image, again)
    assert all(0.05 < (half.min(-1) < 0.9).mean() < 0.6 for half in (image[:, :22], image[:, 22:]))


def test_a_sheet_has_rows_of_poses_hands_and_faces(body):
    image = pose_sheet(body, size=16, samples=1)
    assert image.shape == (22 + 16 + 16, 8 * 16, 3)
    assert all((row.min(-1) < 0.9).mean() > 0.05 for row in np.split(image, (22, 38)))
