"""One pixel and one Gaussian: each step against its equation, in float64."""

import drjit as dr
import numpy as np
import pytest
from drjit.llvm import Float, Float64, UInt32

from gva_mi.splat.kernels.blend import PairGradientSums
from gva_mi.splat.kernels.pixel import (
    PLACES,
    Alpha,
    Pixel,
    PixelAdjoint,
    PixelRow,
    PixelTangent,
    exp2,
    w_tangent,
)
from gva_mi.splat.kernels.records import PairGradient, RecordFormat, Splat
from gva_mi.splat.kernels.tiles import WIDTH
from gva_mi.splat.kernels.vectors import Vec2
from gva_mi.splat.options import SplatOptions

N, D = 50, 3
OPTIONS = SplatOptions()


def random_splat(rng, scale=1.0):
    """N Gaussians whose middles lie about the tile at (0, 0)."""
    number = lambda low, high: Float64(scale * rng.uniform(low, high, N))
    u = Vec2(number(0, 8), number(0, 4))
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


def test_a_step_back_undoes_a_step():
    """Eq. 15 gives back the T that eq. 13 started from, and v is dL/dln alpha of eq. 14."""
    rng = np.random.default_rng(1)
    g, T0 = random_splat(rng), Float64(rng.uniform(0.2, 1, N))
    alpha = at(g, 4, 2)
    y0 = [Float64(rng.normal(size=N)) for _ in range(D)]
    behind = [Float64(rng.normal(size=N)) for _ in range(D)]
    g_y = [Float64(rng.normal(size=N)) for _ in range(D)]
    after = Pixel(T0, UInt32(0), y0).step([alpha.value], [g.features], UInt32(4), None, OPTIONS)
    assert dr.all(after.end == 5) and dr.all(after.T > 0)

    # B: what lies behind the Gaussian, seen through 1/T, with the gradient g
    B = sum(b * d for b, d in zip(behind, g_y, strict=True))
    back, v, weight = PixelAdjoint(after.T, B).step_back(alpha, g.features, g_y, OPTIONS)
    np.testing.assert_allclose(back.T.numpy(), T0.numpy(), rtol=1e-14)
    np.testing.assert_allclose(weight.numpy(), (T0 * alpha.value).numpy(), rtol=1e-14)
    loss = lambda a: sum(
        (d * (T0 * a * f + T0 * (1 - a) * b)).numpy()
        for d, f, b in zip(g_y, g.features, behind, strict=True)
    )
    h = 1e-6
    by_alpha = (loss(alpha.value + h) - loss(alpha.value - h)) / (2 * h)
    np.testing.assert_allclose(v.numpy(), (alpha.value.numpy() * by_alpha), atol=1e-9)
    seen = (loss(alpha.value) / T0.numpy(), back.B.numpy())  # what lies behind the next Gaussian
    np.testing.assert_allclose(*seen, atol=1e-13)


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


def test_the_tangents_step_is_the_derivative_of_the_step():
    rng = np.random.default_rng(2)
    g, d = random_splat(rng), random_splat(rng, 0.3)
    T, dT = rng.uniform(0.2, 1, N), rng.normal(size=N)
    y, dy = rng.normal(size=(D, N)), rng.normal(size=(D, N))
    i, j, h = 3, 1, 1e-6

    def stepped(t):
        along = lambda a, b: Float64(np.array(a) + t * np.array(b))
        moved = Splat(
            Vec2(*(along(a, b) for a, b in zip(g.u, d.u, strict=True))),
            *(along(getattr(g, k), getattr(d, k)) for k in ("p", "q", "r", "lo")),
            [along(a, b) for a, b in zip(g.color, d.color, strict=True)],
            None,
        )
        pixel = Pixel(along(T, dT), UInt32(0), [along(a, b) for a, b in zip(y, dy, strict=True)])
        out = pixel.step([at(moved, i, j).value], [moved.features], UInt32(0), None, OPTIONS)
        return np.stack([x.numpy() for x in (out.T, *out.y)])

    alpha = at(g, i, j)
    dw = w_tangent(g, d, i + 0.5 - g.u.x, j + 0.5 - g.u.y)
    dalpha = alpha.tangent(d.lo, dw, OPTIONS)
    pixel = PixelTangent(Float64(T), Float64(dT), [Float64(x) for x in dy])
    out = pixel.step_tangent(alpha.value, dalpha, g.features, d.features, dr.llvm.Bool(True))
    expected = (stepped(h) - stepped(-h)) / (2 * h)
    smooth = np.abs(alpha_of(g, i, j)[1] / OPTIONS.alpha_min - 1) > 1e-3
    found = np.stack([x.numpy() for x in (out.dT, *out.dy)])
    np.testing.assert_allclose(found[:, smooth], expected[:, smooth], atol=1e-8)
    np.testing.assert_array_equal(out.T.numpy(), stepped(0)[0])


def test_the_sums_of_a_slot_are_equation_16():
    rng = np.random.default_rng(3)
    g, j = random_splat(rng), 2
    row = PixelRow.of(g, Float64(0), Float64(0), j)
    v = [Float64(rng.normal(size=N)) for _ in range(WIDTH)]
    by_y = [[Float64(rng.normal(size=N)) for _ in range(D)] for _ in range(WIDTH)]
    weight = [Float64(rng.uniform(size=N)) for _ in range(WIDTH)]
    format = RecordFormat(D, depth=False, absolute=True)
    zeros = [Float64(0)] * PairGradient.columns(format)
    sums = PairGradientSums(PairGradient.unpack(zeros, format), format)
    for i in range(WIDTH):
        sums.add_pixel(g, at(g, i, j), v[i], weight[i], by_y[i])
    sums.add_row(row, v)
    slot = sums.slot()

    x = np.stack([value.numpy() for value in v])
    w = np.stack([alpha_of(g, i, j)[0] for i in range(WIDTH)])  # (WIDTH, 2, N)
    second = np.einsum("in,ian,ibn->abn", x, w, w)
    q, r = g.q.numpy(), g.r.numpy()
    absolute = [np.abs(x * w[:, 0]).sum(0), np.abs(x * (q * w[:, 0] + r * w[:, 1])).sum(0)]
    grad_f = sum(weight[i].numpy() * np.array(by_y[i]) for i in range(WIDTH))
    expected = [x.sum(0), *np.einsum("in,ian->an", x, w), second[0, 0], second[0, 1], second[1, 1]]
    for found, right in zip(slot.pack(), [*expected, *absolute, *grad_f], strict=True):
        np.testing.assert_allclose(found.numpy(), right, atol=1e-12)


def test_exp2_is_two_to_the_power_of_x():
    x = np.linspace(-125.9, 126.9, 20001).astype(np.float32)
    np.testing.assert_allclose(exp2(Float(x)).numpy(), np.exp2(x.astype(np.float64)), rtol=3.2e-6)
