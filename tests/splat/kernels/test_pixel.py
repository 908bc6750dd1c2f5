"""One pixel and one Gaussian: each step against its equation, in float64."""

import drjit as dr
import numpy as np
import pytest
from drjit.llvm import Float, Float64, UInt32

from gva_mi.splat.kernels.pixel import (
    PLACES,
    Alpha,
    Pixel,
    PixelRow,
    exp2,
)
from gva_mi.splat.kernels.records import Splat
from gva_mi.splat.options import SplatOptions

N, D = 50, 3
OPTIONS = SplatOptions()


def random_splat(rng, scale=1.0):
    """N Gaussians whose middles lie about the tile at (0, 0)."""
    number = lambda low, high: Float64(scale * rng.uniform(low, high, N))
    u = [number(0, 8), number(0, 4)]
    p, q, r = number(0.1, 0.5), number(-0.2, 0.2), number(0.1, 0.5)
    return Splat(u, p, q, r, number(-3, 0), [number(0, 1) for _ in range(D)], None)


def alpha_of(g, i, j):
    """Eq. 11-12 as they are written, by numpy: w (2, N), alpha before and after the cut-offs."""
    u, v, p, q, r, lo = (np.array(x) for x in (*g.u, g.p, g.q, g.r, g.lo))
    dx, dy = i + 0.5 - u, j + 0.5 - v
    w = np.stack([p * dx + q * dy, r * dy])
    free = 2 ** (lo - (w**2).sum(0))
    alpha = np.minimum(free, OPTIONS.alpha_max)
    return w, free, np.where(free >= OPTIONS.alpha_min, alpha, 0)


def at(g, i, j):
    return Alpha.at(PixelRow.of(g, Float64(0), Float64(0), j), PLACES[i], OPTIONS)


@pytest.mark.parametrize("i, j", [(0, 0), (5, 3), (7, 1)])
def test_alpha_is_equations_11_and_12(i, j):
    g = random_splat(np.random.default_rng(0))
    found, (w, _, alpha) = at(g, i, j), alpha_of(g, i, j)
    np.testing.assert_allclose(found.wx.numpy(), w[0], atol=1e-13)
    np.testing.assert_allclose(np.broadcast_to(found.wy.numpy(), N), w[1], atol=1e-13)
    np.testing.assert_allclose(found.value.numpy(), alpha, atol=1e-14)
    assert (alpha == 0).any() and (alpha > 0).any()


def test_a_pixel_stops_before_its_transmittance_falls_too_low_and_stays_stopped():
    pixel = Pixel(Float64(2e-4), UInt32(3), [Float64(0.5)])
    one = lambda pixel, alpha, k, within=None: pixel.step(
        [Float64(alpha)], [[Float64(1)]], UInt32(k), within, OPTIONS
    )
    stopped = one(pixel, 0.6, 3)
    assert stopped.T[0] == -2e-4 and stopped.end[0] == 3 and stopped.y[0][0] == 0.5
    again = one(stopped, 0.1, 4)
    assert again.T[0] == -2e-4 and again.end[0] == 3 and again.y[0][0] == 0.5
    hidden = one(pixel, 0.1, 3, [dr.llvm.Bool(False)])
    assert hidden.T[0] == -2e-4 and hidden.end[0] == 3


def test_gaussians_of_one_turn_are_composited_like_one_after_the_other():
    """Also where the pixel stops within the turn, or before it: the same bits."""
    rng = np.random.default_rng(3)
    alphas = [Float(x) for x in rng.uniform(0, 0.999, (6, N))]
    features = [[Float(x)] for x in rng.normal(size=(6, N))]
    start = Pixel(Float(rng.choice([1, 1e-2, -0.5], N)), UInt32(7), [Float(rng.normal(size=N))])
    turn = start.step(alphas, features, UInt32(10), None, OPTIONS)
    alone = start
    for i in range(6):
        alone = alone.step(alphas[i : i + 1], features[i : i + 1], UInt32(10 + i), None, OPTIONS)
    for a, b in zip((turn.T, turn.end, *turn.y), (alone.T, alone.end, *alone.y), strict=True):
        assert (a.numpy() == b.numpy()).all()
    assert 0 < (turn.T.numpy() < 0).sum() < N


def test_the_polynomial_is_a_power_of_two():
    x = np.linspace(-125.9, 126.9, 20001).astype(np.float32)
    np.testing.assert_allclose(exp2(Float(x)).numpy(), np.exp2(x.astype(np.float64)), rtol=3.2e-6)
