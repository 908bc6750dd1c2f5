"""One pixel: where it stops, several Gaussians a turn, and powers of two.

``tests/splat/gsplat`` and ``tests/gradcheck`` compare equations 11 to 17 with the reference.
"""

import drjit as dr
import numpy as np
from drjit.llvm import Float, Float64, UInt32

from gva_mi.splat.kernels.pixel import Pixel, exp2
from gva_mi.splat.options import SplatOptions

N = 50
OPTIONS = SplatOptions()


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


def test_exp2_is_two_to_the_power_of_x():
    x = np.linspace(-125.9, 126.9, 20001).astype(np.float32)
    np.testing.assert_allclose(exp2(Float(x)).numpy(), np.exp2(x.astype(np.float64)), rtol=3.2e-6)
