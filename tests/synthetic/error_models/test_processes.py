"""Random curves, bumps, runs and fields."""

import numpy as np
import pytest

from gva_mi.synthetic.error_models.processes import bumps, curve, field, runs


@pytest.mark.parametrize("white", [0.0, 0.4, 1.0])
def test_a_curve_has_unit_size(rng, white):
    size = (curve(rng, 4000, 5.0, white) ** 2).sum(1).mean()
    assert abs(size - 1) < 0.05


def test_bumps_rise_from_calm_to_at_most_the_top(rng):
    found = bumps(rng, 4000, 0.6, 3.0, 25.0, 2.5)
    assert found.min() == pytest.approx(0.6) and 2.5 < found.max() <= 3.0
    assert (bumps(rng, 50, 0.8, 0.8, 25.0, 2.5) == 0.8).all()


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_runs_cover_their_share_of_the_frames(rng, share):
    inside = runs(rng, 6000, share, 5.0)
    assert abs(inside.mean() - share) < 0.3 * share
    starts = (inside[1:] & ~inside[:-1]).sum()
    assert inside.sum() / starts > 4  # frames in a row


def test_a_field_is_smooth_over_its_length(rng):
    image = field(rng, (96, 128), 20.0)
    assert image.shape == (96, 128) and image.std() == pytest.approx(1)
    assert np.diff(image, axis=1).std() < 0.15
