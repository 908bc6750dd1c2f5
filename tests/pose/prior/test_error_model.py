"""The error model is recovered from errors that were drawn from it."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JAW_AND_EYES, JOINTS
from gva_mi.prior.error_model import (
    GROUPS,
    Stage1ErrorModel,
    covariance,
    fit_slow_part,
    white_level,
)

TIMES = torch.arange(120)
GUESS = Stage1ErrorModel(0.0, 0.3, 6.0)


def draw(noise, joints=8, seed=0):
    """Errors (n, J) of one coordinate, without bias."""
    K = covariance([noise], TIMES, *2 * [torch.ones(1, len(TIMES))])[0] - noise.slow**2
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(len(TIMES), joints, generator=generator, dtype=torch.float64)
    return (torch.linalg.cholesky(K) @ white).float()


def vectors(noise):
    """Errors (n, J, 3)."""
    return torch.stack([draw(noise, seed=s) for s in range(3)], -1)


def test_every_joint_but_those_of_the_face_is_in_one_group():
    members = sorted(i for group in GROUPS.values() for i in group)
    face = range(len(JOINTS))[JAW_AND_EYES]
    assert members == [i for i in range(len(JOINTS)) if i not in face]


@pytest.mark.parametrize("white", [0.02, 0.2])
def test_white_errors_are_separated_from_motion_and_lasting_errors(white):
    errors = vectors(Stage1ErrorModel(white, 0.1, 12.0))
    errors[..., 0] += 0.05 * TIMES[:, None]  # the joint turns
    assert white_level(errors.diff(dim=0)) == pytest.approx(white, rel=0.15)


@pytest.mark.parametrize("memory", [1.5, 6.0, 12.0])
def test_size_and_memory_of_lasting_errors_are_found(memory):
    found = fit_slow_part(draw(Stage1ErrorModel(0.05, 0.2, memory), joints=40), TIMES, 0.05, GUESS)
    assert found.slow == pytest.approx(0.2, rel=0.25)
    assert memory / 2 <= found.memory <= 2 * memory


def test_the_covariance_is_the_sum_of_its_parts():
    noise = Stage1ErrorModel(0.1, 0.3, 5.0)
    K = covariance([noise], torch.tensor([0, 1000]), torch.tensor([[1.0, 4.0]]), torch.ones(1, 2))[
        0
    ].numpy()
    np.testing.assert_allclose(K, [[0.01 + 2 * 0.09, 0.09], [0.09, 0.04 + 2 * 0.09]], atol=1e-8)


def test_a_known_bias_takes_the_place_of_the_slow_part():
    given = torch.tensor([0, 1000]), torch.ones(1, 2), torch.ones(1, 2)
    noise = Stage1ErrorModel(0.1, 0.3, 5.0, bias=0.2)
    K = covariance([noise], *given)[0].numpy()
    np.testing.assert_allclose(K, [[0.01 + 0.09 + 0.04, 0.04], [0.04, 0.14]], atol=1e-8)
    same = covariance([Stage1ErrorModel(0.1, 0.3, 5.0, bias=0.3)], *given)
    assert torch.equal(same, covariance([Stage1ErrorModel(0.1, 0.3, 5.0)], *given))


@pytest.mark.parametrize("gap", [1, 3])
def test_a_known_estimator_errs_more_while_a_joint_moves(gap):
    """At rest ``slow``; at a speed ``v`` of every coordinate, in each frame, hypot(slow, lag v)."""
    noise, times = Stage1ErrorModel(0.0, 0.03, 6.0, bias=0.1, lag=4.0), torch.arange(0, 120, gap)
    steps = torch.zeros(len(times) - 1, 3)
    steps[len(steps) // 2 :] = 0.02 * gap
    growth = noise.growth(steps, times)
    K = covariance([noise], times, torch.zeros(1, len(times)), growth[None])[0]
    size, k = np.hypot(0.03, 4.0 * 0.02), 3**0.5 * gap / 6.0
    assert float(K[0, 0]) == pytest.approx(0.03**2 + 0.1**2)
    assert float(K[-1, -1]) == pytest.approx(size**2 + 0.1**2)
    assert float(K[-1, -2]) == pytest.approx(size**2 * (1 + k) * np.exp(-k) + 0.1**2)
    assert float(K[-1, 0]) == pytest.approx(0.1**2, rel=1e-3)
    assert (growth.diff() >= -1e-6).all()
    assert (noise.growth(steps[:0], times[:1]) == 1).all()  # one frame shows no speed
