"""Random curves, bumps, runs and fields."""

import pytest

from gva_mi.synthetic.error_models.processes import curve, runs


@pytest.mark.parametrize("white", [0.0, 0.4, 1.0])
def test_a_curve_has_unit_size(rng, white):
    size = (curve(rng, 4000, 5.0, white) ** 2).sum(1).mean()
    assert abs(size - 1) < 0.05


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_runs_cover_their_share_of_the_frames(rng, share):
    inside = runs(rng, 6000, share, 5.0)
    assert abs(inside.mean() - share) < 0.3 * share
    starts = (inside[1:] & ~inside[:-1]).sum()
    assert inside.sum() / starts > 4  # frames in a row
