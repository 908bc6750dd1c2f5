"""Error model of masks: the boundary, lost feet, and a bag."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.synthetic.error_models.masks import (
    Confusion,
    MaskErrors,
    confusions,
    noisy_mask,
)

USUAL = MaskErrors()


def test_a_mask_is_off_at_its_boundary_only(disc, rng):
    mask, _ = disc
    noisy = noisy_mask(mask, USUAL, 1.0, rng)
    y, x = np.mgrid[:64, :64] - 31.5
    r = np.hypot(x, y)
    assert not np.array_equal(noisy, mask)
    assert (noisy[r < 20] == 1).all() and (noisy[r > 28] == 0).all()
    assert ((noisy > 0.5) & (mask > 0.5)).sum() > 0.9 * ((noisy > 0.5) | (mask > 0.5)).sum()
    numbers = (0.103937, 0.780935, 0.786507, 0.826753)  # published figures depend on them
    assert np.allclose(noisy[8, 26:30], numbers, rtol=0, atol=2e-6)


@pytest.mark.parametrize("grown", [-20.0, 20.0])
def test_a_boundary_is_shifted_all_around(disc, grown):
    """20 pixels at width 512 are 2.5 pixels here; the radius is 24."""
    still = MaskErrors(wobble=0.0, notches=0, grown=grown)
    area = noisy_mask(disc[0], still, 1.0, np.random.default_rng(0)).sum()
    assert abs(np.sqrt(area / np.pi) - (24 + np.sign(grown) * 2.5)) < 0.5


def test_a_foot_is_cut_off_and_a_bag_is_added_where_they_are(disc, rng):
    seen = Confusion((((32, 44), (0, 1), 30),), (58, 20, 5))
    mask = noisy_mask(disc[0], MaskErrors(wobble=0.0, notches=0), 1.0, rng, seen)
    assert not mask[46:].any() and (mask[36:42, 28:36] > 0.9).all()  # below the ankle; above it
    assert mask[20, 58] == 1 and mask[20, 52] == 1  # outside the ball


def standing(frames=300):
    pose = Pose.rest(frames)
    pose.rotations[:, 0, 1] = torch.linspace(0, 2 * torch.pi, frames)
    return pose, Shape(torch.zeros(10))


def test_feet_are_lost_in_runs_of_the_given_share(body, camera, rng):
    found = confusions(body, *standing(), camera, MaskErrors(lost_feet=0.3), 1.0, rng)
    lost = np.array([len(seen.lost) for seen in found])
    assert 0.15 < lost.mean() / 2 < 0.45
    assert (np.diff(lost) != 0).mean() < 0.25
