"""The forward-backward sums of directions, against all sequences written out."""

from itertools import product

import pytest
import torch

from gva_mi.stage1.arm_depths import MODE_SPEEDS, DirectionModel

FRAMES, DIRECTIONS = 4, 3


def random_model():
    torch.manual_seed(0)
    rows = lambda *shape: torch.softmax(torch.randn(shape, dtype=torch.float64), -1)
    return DirectionModel(torch.eye(3), rows(2, DIRECTIONS, DIRECTIONS), rows(2, 2))


def test_the_posterior_is_the_sum_over_all_sequences():
    model = random_model()
    energy = torch.randn(2, FRAMES, DIRECTIONS, dtype=torch.float64)
    found = model.posterior(energy)
    for limb in range(2):
        expected = torch.zeros(FRAMES, DIRECTIONS, dtype=torch.float64)
        states = list(product(range(2), range(DIRECTIONS)))
        for path in product(states, repeat=FRAMES):
            p = torch.exp(-sum(energy[limb, t, s] for t, (_, s) in enumerate(path)))
            for (mode, before), (after, s) in zip(path, path[1:], strict=False):
                p = p * model.steps[mode, before, s] * model.modes[mode, after]
            for t, (_, s) in enumerate(path):
                expected[t, s] += p
        expected = expected / expected.sum(1, keepdim=True)
        assert torch.allclose(found[limb], expected, atol=1e-12)


@pytest.mark.parametrize("fps", [15, 30, 120])
def test_a_step_has_the_variance_of_its_speed_at_any_frame_rate(fps):
    model = DirectionModel.of(1 / fps)
    square = (model.directions[:, None] - model.directions).square().sum(2)
    for steps, speed in zip(model.steps, MODE_SPEEDS, strict=True):
        assert torch.allclose(steps.sum(1), torch.ones(len(steps), dtype=steps.dtype))
        variance = float((steps * square).sum(1).mean() / 2)
        assert variance == pytest.approx((speed / fps) ** 2, rel=0.06)
