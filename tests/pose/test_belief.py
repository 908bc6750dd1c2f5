"""What can be known of a motion before any picture is looked at."""

import pytest
import torch

from gva_mi.pose.belief import Belief
from gva_mi.pose.noise import Noise

N = 90
TIMES = torch.arange(N)


def noisy(truth, white, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return truth + white * torch.randn(truth.shape, generator=generator)


def believe(y, white, steady=False):
    noises = [Noise(white, 0.02, 6.0)] * y.shape[1]
    return Belief.of_stage1(TIMES, y.diff(dim=0), noises, steady)


def rms(x):
    return float(x.square().mean().sqrt())


def mean_of_neighbours(y, half):
    padded = torch.cat([y[:1].expand(half, -1, -1), y, y[-1:].expand(half, -1, -1)])
    return torch.stack([padded[k : k + 2 * half + 1].mean(0) for k in range(len(y))])


def test_white_errors_fall_more_than_under_means_over_neighbours():
    """Over five frames; and nearly as much as under the best mean, which one cannot know."""
    t = TIMES[:, None, None] / 15.0
    truth = 0.3 * torch.sin(t + torch.arange(3))
    y = noisy(truth, 0.1)
    means = [rms(mean_of_neighbours(y, half) - truth) for half in range(9)]
    corrections, _ = believe(y, 0.1).likeliest()
    left = rms(y + corrections - truth)
    assert left < means[2] and left < 1.25 * min(means)


def test_a_joint_at_rest_comes_out_at_rest():
    truth = torch.zeros(N, 4, 3)
    corrections, _ = believe(noisy(truth, 0.1), 0.1).likeliest()
    assert rms((noisy(truth, 0.1) + corrections).diff(dim=0)) < 0.01


def test_a_fast_motion_survives():
    """Up and down by one radian within half a second, in the midst of rest."""
    truth = torch.zeros(N, 1, 3)
    truth[40:56, 0, 0] = 0.5 - 0.5 * torch.cos(torch.arange(16) * torch.pi / 7.5)
    corrections, _ = believe(noisy(truth, 0.005), 0.005).likeliest()
    found = noisy(truth, 0.005) + corrections
    assert float(found[40:56, 0, 0].max()) > 0.85


def test_a_frame_that_is_lost_takes_the_value_of_its_neighbours():
    y = noisy(torch.zeros(N, 1, 3), 0.01)
    y[30:32] += 1.0
    corrections, belief = believe(y, 0.01).likeliest()
    assert (y + corrections)[30:32].abs().max() < 0.05
    assert belief.factors[0, 30:32].min() > 50 * belief.factors[0].median()


def test_who_may_move_steadily_is_not_slowed_down():
    y = noisy(0.1 * TIMES[:, None, None].expand(N, 1, 3), 0.02)
    corrections, _ = believe(y, 0.02, steady=True).likeliest()
    speed = (y + corrections).diff(dim=0).mean()
    assert float(speed) == pytest.approx(0.1, rel=0.01)
    assert rms((y + corrections).diff(dim=0) - 0.1) < 0.01


def test_energy_has_its_least_value_where_it_is_said_to_be():
    belief = believe(noisy(torch.zeros(N, 2, 3), 0.1), 0.1)
    corrections, belief = belief.likeliest()
    precision = belief.precision()
    energy = lambda c: float(belief.energy(precision, c, c))
    generator = torch.Generator().manual_seed(1)
    for _ in range(5):
        aside = 0.02 * torch.randn(corrections.shape, generator=generator)
        assert energy(corrections) < energy(corrections + aside)


def test_what_lasts_passes_unchanged_and_tremor_is_damped():
    belief = believe(noisy(torch.zeros(N, 1, 3), 0.01), 0.01)
    M = belief.spread(torch.zeros(N, 1, 3))[0]
    constant, tremor = torch.ones(N), (-1.0) ** TIMES
    assert rms(M @ constant) == pytest.approx(1, abs=0.1)
    assert rms(M @ tremor) < 0.3


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("steady", [False, True])
def test_short_videos_are_no_special_case(n, steady):
    y = torch.zeros(n, 2, 3)
    belief = Belief.of_stage1(torch.arange(n), y.diff(dim=0), [Noise(0, 0.1, 6.0)] * 2, steady)
    corrections, belief = belief.likeliest()
    assert torch.equal(corrections, torch.zeros_like(y))
    assert belief.spread(corrections).shape == (2, n, n)
