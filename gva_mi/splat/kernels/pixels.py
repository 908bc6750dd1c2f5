"""What one SIMD lane of the compositing sees: its tile's pixels, and a Gaussian's exponent there.

One lane is one tile. Its 32 pixels are unrolled in the trace, so a value per pixel is a list of 32
Dr.Jit variables; no operation crosses lanes. Pictures are planes padded to whole tiles, so that a
row of a tile is one packet.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets
from gva_mi.splat.kernels.project import GEOMETRY
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists

PIXELS = WIDTH * HEIGHT
PLACES = [i - (WIDTH - 1) / 2 for i in range(WIDTH)]  # of a row's pixels about its middle

# 2^f on [-1/2, 1/2], relative error 2e-7
EXP2 = (1.0, 0.69314720, 0.24022651, 0.05550357, 0.00961814, 0.00133335)
ROUND = 12582912.0  # 1.5 * 2^23: adding it rounds a float32 to an integer in the low bits


@dataclass(frozen=True)
class Planes:
    """The picture, padded to whole tiles; flat arrays."""

    color: Array  # (rows, columns, D), background blended in
    alpha: Array  # (rows, columns)
    depth: Array  # (rows, columns); None where it is not made, or no loss looks at it


def exp2(x: Array) -> Array:
    """2^x for -126 < x < 127: a polynomial in float32, 30 % faster than ``dr.exp2``."""
    if packets.is_double(type(x)):
        return dr.exp2(x)
    F, I = type(x), dr.int32_array_t(type(x))
    shifted = x + ROUND
    fraction = x - (shifted - ROUND)
    value = F(EXP2[-1])
    for c in EXP2[-2::-1]:
        value = dr.fma(value, fraction, c)
    bits = dr.reinterpret_array(I, value) + (dr.reinterpret_array(I, shifted) << 23)
    return dr.reinterpret_array(F, bits)


def larger(a: Array, b: Array) -> Array:
    return dr.select(a > b, a, b)


def smaller(a: Array, b: Array) -> Array:
    return dr.select(a < b, a, b)


def corner(lists: Lists, grid: Grid, F: type) -> tuple[Array, Array]:
    """The tile's left and upper border, px."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    return F((lists.tile - row * columns) * WIDTH), F(row * HEIGHT)


def pixel_rows(lists: Lists, grid: Grid) -> list[Array]:
    """Index of each of the tile's rows of pixels, counted in rows of a tile's width."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    first = row * (columns * HEIGHT) + (lists.tile - row * columns)
    return [first + columns * j for j in range(HEIGHT)]


@dataclass(frozen=True)
class Gaussian:
    u: Array
    v: Array
    p: Array
    q: Array
    r: Array
    lo: Array
    f: list[Array]


def load(rows: packets.Packets, features: int, ids: Array, k: Array, inside: Array) -> Gaussian:
    """Pair ``k``; where not ``inside`` the tile's list, a Gaussian that no pixel sees."""
    gaussian = dr.gather(type(ids), ids, k, active=inside)
    u, v, p, q, r, lo, *f = packets.load(rows, GEOMETRY + features, gaussian)
    return Gaussian(u, v, p, q, r, dr.select(inside, lo, -1e30), f)


@dataclass(frozen=True)
class PixelRow:
    """Eq. 1-2 of blend.py along one row of the tile's pixels.

    Along a row w_y is one number and w_x = middle + p e, where e are the pixels' places about the
    row's middle: a few values for all pixels, and small numbers where cancellation would hurt.
    """

    p: Array
    middle: Array  # w_x at e = 0
    wy: Array
    base: Array  # lo - w_y^2

    @staticmethod
    def of(g: Gaussian, x: Array, y: Array, j: int) -> PixelRow:
        dy = y - g.v + (j + 0.5)
        wy = g.r * dy
        return PixelRow(g.p, g.p * (x - g.u + WIDTH / 2) + g.q * dy, wy, dr.fma(-wy, wy, g.lo))

    def wx(self, e: float) -> Array:
        """Eq. 1."""
        return dr.fma(self.p, e, self.middle)

    def exponent(self, wx: Array) -> Array:
        """Of eq. 2: lo - |w|^2."""
        return dr.fma(-wx, wx, self.base)
