"""One pixel meets one Gaussian: a compositing step, its adjoint and its tangent (paper, Eq. 3).

Per pixel, over the Gaussians i of its tile's list in depth order, with d_i = pixel centre - u_i and
L_i = [[p, q], [0, r]], lo_i of eq. 6-7 (ellipse.py):

(11)  w_i     = L_i d_i = (p d_x + q d_y, r d_y)
(12)  alpha_i = min(alpha_max, 2^(lo_i - |w_i|^2));  0 where that is below alpha_min
(13)  T_0 = 1,  T_{i+1} = T_i (1 - alpha_i);  stop before T_{i+1} falls to transmittance_min, and
      before the first Gaussian that is not nearer than the pixel's limit, if it has one
(14)  y_k     = sum_i T_i alpha_i f_ik + T background_k,   alpha = 1 - T,   T the last one

The product of the paper's Eq. 3 includes i itself; it must not (T_i = prod_{j<i}). The features f
are the channels of the colour and, last, the depth, whose background is 0.

Adjoint, back to front, from g_k = dL/dy_k, h = dL/dalpha, the last T and where the pixel stopped:

(15)  T_i = T_{i+1} / (1 - alpha_i)
      v_i = T_i alpha_i (f_i . g - B_i)                        dL/dln alpha_i; 0 if clamped
      B_{i-1} = B_i + alpha_i (f_i . g - B_i)                  what lies behind i - 1, times g;
                                                               behind the last: background . g - h
(16)  m0 = sum v,  m1 = sum v w,  m2 = sum v w w^T,  grad_f_k = sum T_i alpha_i g_k
      over the tile's pixels, for every pair (tile, Gaussian);  grad_background_k = sum T g_k

Eq. 15 adds and multiplies numbers of similar size. From front to back, what lies behind i would be
a difference: the whole minus what was passed. Behind an opaque Gaussian that is only the rounding
of both. T and B are the whole state of a pixel.

With ``absolute`` there are two more sums, of |v w_x| and of |v (q w_x + r w_y)|: absolute values of
each pixel's derivatives with respect to u, without the factors that all pixels share.

Tangent, where d_ marks tangents and ln2 comes from the base in eq. 12:

(17)  d_w     = (d_p d_x + d_q d_y - p d_u_x - q d_u_y, d_r d_y - r d_u_y)
      d_alpha = ln2 alpha (d_lo - 2 w . d_w);  0 where alpha is clamped
      d_T_{i+1} = d_T_i (1 - alpha) - T_i d_alpha
      d_y_k   = sum_i (d_T_i alpha + T_i d_alpha) f_k + T_i alpha d_f_k
                + d_T background_k + T d_background_k,   d_alpha of the picture = -d_T

The steps are below, beside each other; the sums of eq. 16 are in blend.py. The loops over
the lists are in blend.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.records import Splat
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH
from gva_mi.splat.kernels.vectors import Vec2
from gva_mi.splat.options import SplatOptions

PIXELS = WIDTH * HEIGHT  # of a tile, which is one lane
PLACES = [i - (WIDTH - 1) / 2 for i in range(WIDTH)]  # px, of a row's pixels from its middle
MIRRORED = [i for left in range(WIDTH // 2) for i in (left, WIDTH - 1 - left)]  # outside inwards
LN2 = math.log(2.0)


@dataclass(frozen=True)
class PixelRow:
    """Eq. 11 and the exponent of eq. 12 along one row of a tile's pixels.

    Along a row w_y is constant and w_x = middle + p e, where e is a pixel's position relative to
    the row's middle: few values for all pixels, and small ones where cancellation would hurt.
    """

    p: Array
    middle: Array  # w_x at e = 0
    wy: Array
    base: Array  # lo - w_y^2

    @staticmethod
    def of(g: Splat, x: Array, y: Array, j: Array | int) -> PixelRow:
        """Row ``j`` of the tile whose left upper corner is (x, y), px."""
        dy = y - g.u.y + (j + 0.5)
        wy = g.r * dy
        middle = g.p * (x - g.u.x + WIDTH / 2) + g.q * dy
        return PixelRow(g.p, middle, wy, dr.fma(-wy, wy, g.lo))


@dataclass(frozen=True)
class Alpha:
    """Eq. 11-12 at one pixel."""

    wx: Array
    wy: Array
    free: Array  # before it is clamped
    value: Array

    @staticmethod
    def at(row: PixelRow, e: float, options: SplatOptions, shown: Array | None = None) -> Alpha:
        """Evaluate at the place ``e`` of a row; 0 where the pixel does not show the Gaussian."""
        wx = dr.fma(row.p, e, row.middle)
        exponent = dr.fma(-wx, wx, row.base)
        free = exp2(exponent)
        seen = exponent >= math.log2(options.alpha_min)
        seen = seen if shown is None else seen & shown
        return Alpha(wx, row.wy, free, dr.select(seen, smaller(free, options.alpha_max), 0))

    def tangent(self, dlo: Array, dw: Vec2, options: SplatOptions) -> Array:
        """Eq. 17, d_alpha."""
        dalpha = LN2 * self.value * (dlo - 2 * (self.wx * dw.x + self.wy * dw.y))
        return dr.select(self.free <= options.alpha_max, dalpha, 0)


def w_tangent(g: Splat, d: Splat, dx: Array, dy: Array) -> Vec2:
    """Eq. 17, d_w at the offset (dx, dy) from a Gaussian ``g`` whose tangent is ``d``."""
    return Vec2(d.p * dx + d.q * dy - g.p * d.u.x - g.q * d.u.y, d.r * dy - g.r * d.u.y)


@dataclass(frozen=True)
class Pixel:
    """State of one pixel, from front to back."""

    T: Array  # transmittance; negative once the pixel has stopped
    end: Array  # in its tile's list: one past the last Gaussian that it shows
    y: list[Array]  # the sums of eq. 14 so far

    def step(
        self,
        alphas: Iterable[Array],
        features: Sequence[list[Array]],
        k: Array,
        within: Sequence[Array] | None,
        options: SplatOptions,
    ) -> Pixel:
        """Eq. 13-14: composite the Gaussians of one turn.

        After a pixel has stopped T falls on, so every later test fails too. Therefore no Gaussian
        waits for the test of the one before it.

        Args:
            alphas: eq. 12, front to back.
            features: of the Gaussians.
            k: place in the list of the first one.
            within: whether each is nearer than the pixel's limit; None where pixels have none.
            options: cut-offs.
        """
        T, shown, end, y = self.T, dr.abs(self.T), self.end, self.y
        for turn, (alpha, f) in enumerate(zip(alphas, features, strict=True)):
            rest = dr.fma(-alpha, T, T)
            ok = rest > options.transmittance_min
            if within is not None:
                ok &= within[turn]
            weight = dr.select(ok, alpha * T, 0)
            y = [dr.fma(weight, f[c], y[c]) for c in range(len(f))]
            shown, end = dr.select(ok, rest, shown), dr.select(ok, k + (turn + 1), end)
            T = rest
        return Pixel(dr.select(ok, shown, -shown), end, y)


@dataclass(frozen=True)
class PixelAdjoint:
    """State of one pixel, from back to front."""

    T: Array  # transmittance behind the Gaussian that comes next
    B: Array | None = None  # what lies there, times g; None if no v is needed

    def step_back(
        self, alpha: Alpha, f: list[Array], g: list[Array], options: SplatOptions
    ) -> tuple[PixelAdjoint, Array | None, Array]:
        """Eq. 15: undo the step of one Gaussian; also return v_i and T_i alpha_i.

        Args:
            alpha: eq. 12, 0 where the pixel does not show the Gaussian.
            f: its features, at least those of ``g``.
            g: the gradient of the pixel's sums.
            options: cut-offs.
        """
        T = self.T / (1 - alpha.value)
        weight = T * alpha.value
        if self.B is None:
            return PixelAdjoint(T), None, weight
        apart = -self.B  # f . g - B
        for c in range(len(g)):
            apart = dr.fma(f[c], g[c], apart)
        v = dr.select(alpha.free <= options.alpha_max, weight * apart, 0)
        return PixelAdjoint(T, dr.fma(alpha.value, apart, self.B)), v, weight

    def fields(self) -> list[Array]:
        """Return T, and B if there is one."""
        return [self.T] if self.B is None else [self.T, self.B]


@dataclass(frozen=True)
class PixelTangent:
    """State of one pixel and its tangent, from front to back."""

    T: Array  # as in Pixel
    dT: Array
    dy: list[Array]

    def step_tangent(
        self, alpha: Array, dalpha: Array, f: list[Array], df: list[Array], shown: Array
    ) -> PixelTangent:
        """Eq. 17, d_T and d_y, for one Gaussian.

        Args:
            alpha, dalpha: eq. 12 and 17.
            f, df: the Gaussian's features, and their tangents.
            shown: whether the pixel shows it.
        """
        T, dT = self.T, self.dT
        weight, dweight = alpha * T, dT * alpha + T * dalpha
        rest = dr.fma(-alpha, T, T)
        weight, dweight = dr.select(shown, weight, 0), dr.select(shown, dweight, 0)
        dy = [self.dy[c] + (dweight * f[c] + weight * df[c]) for c in range(len(f))]
        return PixelTangent(dr.select(shown, rest, -dr.abs(T)), dT - dweight, dy)

    @staticmethod
    def state(pixels: list[PixelTangent]) -> list[Array]:
        """Flatten the pixels of a tile to the loop's variables."""
        dy = [number for pixel in pixels for number in pixel.dy]
        return [*(pixel.T for pixel in pixels), *(pixel.dT for pixel in pixels), *dy]

    @staticmethod
    def of_state(state: Sequence[Array]) -> list[PixelTangent]:
        """The reverse of :meth:`state`."""
        T, dT, dy = state[:PIXELS], state[PIXELS : 2 * PIXELS], list(state[2 * PIXELS :])
        n = len(dy) // PIXELS
        return [PixelTangent(T[i], dT[i], dy[n * i : n * i + n]) for i in range(PIXELS)]


# Taylor series of 2^f, (ln 2)^n / n!, on [-1/2, 1/2]: relative error 3.2e-6 at the ends (tested),
# 1e-7 within 1/4
EXP2 = (1.0, 0.69314720, 0.24022651, 0.05550357, 0.00961814, 0.00133335)
ROUNDING_SHIFT = 12582912.0  # 1.5 * 2^23: adding it rounds a float32 to an integer in the low bits


def exp2(x: Array) -> Array:
    """2^x for -126 < x < 127: a polynomial in float32, 30 % faster than ``dr.exp2``."""
    if packets.is_double(type(x)):
        return dr.exp2(x)
    F, I = type(x), dr.int32_array_t(type(x))
    shifted = x + ROUNDING_SHIFT
    fraction = x - (shifted - ROUNDING_SHIFT)
    value = F(EXP2[-1])
    for c in EXP2[-2::-1]:
        value = dr.fma(value, fraction, c)
    bits = dr.reinterpret_array(I, value) + (dr.reinterpret_array(I, shifted) << 23)
    return dr.reinterpret_array(F, bits)


def larger(a: Array, b: Array) -> Array:
    """``dr.maximum`` without NaN handling."""
    return dr.select(a > b, a, b)


def smaller(a: Array, b: Array) -> Array:
    """``dr.minimum`` without NaN handling."""
    return dr.select(a < b, a, b)
