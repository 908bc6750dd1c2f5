"""The MAP estimate of a motion without any image."""

import numpy as np
import pytest
import torch

from gva_mi.prior.error_model import Stage1ErrorModel
from gva_mi.prior.inference import updated_process
from gva_mi.prior.process import ProcessPrior

N = 90
TIMES = torch.arange(N)


def noisy(truth, white):
    return truth + white * torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))


def process_of(y, white, steady=False):
    error_models = [Stage1ErrorModel(white, 0.02, 6.0)] * y.shape[1]
    return ProcessPrior.of_stage1(TIMES, y.diff(dim=0), error_models, steady)


def estimate(y, white, steady=False):
    corrections, process = process_of(y, white, steady).map_estimate()
    return y + corrections, process


def rms(x):
    return float(x.square().mean().sqrt())


def test_a_fast_motion_survives():
    """Up and down by one radian within half a second, in the midst of rest."""
    truth = torch.zeros(N, 1, 3)
    truth[40:56, 0, 0] = 0.5 - 0.5 * torch.cos(torch.arange(16) * torch.pi / 7.5)
    found, _ = estimate(noisy(truth, 0.005), 0.005)
    assert float(found[40:56, 0, 0].max()) > 0.85


def test_a_short_gesture_of_a_known_estimator_has_its_speed():
    """Raised and lowered by 0.6 radians within five frames: a median of 21 frames sees rest."""
    y = np.zeros(N)
    y[42:47] = [0, 0.3, 0.6, 0.3, 0]
    steps = torch.zeros(N - 1, 2, 3)
    steps[..., 0] = torch.from_numpy(np.diff(y))[:, None]
    known, guessed = Stage1ErrorModel(0.0, 0.05, 6.0, bias=0.0), Stage1ErrorModel(0.0, 0.05, 6.0)
    process = ProcessPrior.of_stage1(TIMES, steps, [known, guessed])
    found = process.square_speed[44]
    # Over eight frames around each, of three coordinates; then a Gaussian mean over four frames.
    far = [(y[min(k + 4, N - 1)] - y[max(k - 4, 0)]) ** 2 / 8 / 3 for k in range(N - 1)]
    near = np.exp(-((np.arange(N - 1) - 44) ** 2) / 32)
    assert float(found[0]) == pytest.approx(near @ far / near.sum(), rel=0.02)
    assert found[0] > 20 * found[1]
    slower = updated_process(process, [known, guessed], torch.zeros(N, 2, 3), 0.1 * process.steps)
    assert torch.equal(slower.square_speed[:, 0], process.square_speed[:, 0])
    assert not torch.equal(slower.square_speed[:, 1], process.square_speed[:, 1])


def test_an_outlier_takes_the_value_of_its_neighbours():
    y = noisy(torch.zeros(N, 1, 3), 0.01)
    y[30:32] += 1.0
    found, process = estimate(y, 0.01)
    assert found[30:32].abs().max() < 0.05
    assert process.factors[0, 30:32].min() > 50 * process.factors[0].median()


def test_a_steady_motion_keeps_its_speed():
    found, _ = estimate(noisy(0.1 * TIMES[:, None, None].expand(N, 1, 3), 0.02), 0.02, steady=True)
    speed = found.diff(dim=0)
    assert float(speed.mean()) == pytest.approx(0.1, rel=0.01) and rms(speed - 0.1) < 0.01


def test_the_map_estimate_minimises_the_energy():
    """The slopes of its two terms cancel there, and not elsewhere."""
    corrections, process = process_of(noisy(torch.zeros(N, 2, 3), 0.1), 0.1).map_estimate()

    def slope(at, precision):
        leaf = at.clone().requires_grad_()
        return torch.autograd.grad(process.energy(precision, leaf, leaf), leaf)[0]

    P = process.precision()
    of_motion = slope(corrections, 0 * P.M).norm()
    assert slope(corrections, P).norm() < 1e-2 * of_motion
    assert slope(0.9 * corrections, P).norm() > 0.05 * of_motion


def test_the_preconditioner_passes_lasting_errors_and_damps_tremor():
    process = process_of(noisy(torch.zeros(N, 1, 3), 0.01), 0.01)
    M = process.preconditioner(torch.zeros(N, 1, 3)).M[0]
    assert rms(M @ torch.ones(N)) == pytest.approx(1, abs=0.1)
    assert rms(M @ (-1.0) ** TIMES) < 0.3


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("steady", [False, True])
def test_short_videos_are_no_special_case(n, steady):
    y = torch.zeros(n, 2, 3)
    process = ProcessPrior.of_stage1(
        torch.arange(n), y.diff(dim=0), [Stage1ErrorModel(0, 0.1, 6.0)] * 2, steady
    )
    corrections, process = process.map_estimate()
    assert torch.equal(corrections, torch.zeros_like(y))
    assert process.preconditioner(corrections).M.shape == (2, n, n)
