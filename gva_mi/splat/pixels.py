"""What one SIMD lane of the compositing sees: its tile's pixels, and a Gaussian's exponent there.

One lane is one tile. Its 32 pixels are unrolled in the trace, so a value per pixel is a list of 32
Dr.Jit variables; no operation crosses lanes. Pictures are planes padded to whole tiles, so that a
row of a tile is one packet.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat import packets
from gva_mi.splat.project import GEOMETRY
from gva_mi.splat.tiles import HEIGHT, WIDTH, Grid, Lists

PIXELS = WIDTH * HEIGHT

# 2^f on [-1/2, 1/2], relative error 2e-7
EXP2 = (1.0, 0.69314720, 0.24022651, 0.05550357, 0.00961814, 0.00133335)
ROUND = 12582912.0  # 1.5 * 2^23: adding it rounds a float32 to an integer in the low bits


@dataclass(frozen=True)
class Planes:
    """The picture, padded to whole tiles; flat arrays."""

    color: Array  # (rows, columns, D), background blended in
    alpha: Array  # (rows, columns)
    depth: Array  # (rows, columns); None in an adjoint where no loss looks at it


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


def load(rows: packets.Packets, features: int, ids: Array, k: Array, end: Array) -> Gaussian:
    """Pair ``k``; past the end of the list a Gaussian that no pixel sees."""
    inside = k < end
    gaussian = dr.gather(type(ids), ids, k, active=inside)
    u, v, p, q, r, lo, *f = packets.load(rows, GEOMETRY + features, gaussian)
    return Gaussian(u, v, p, q, r, dr.select(inside, lo, -1e30), f)


def whitened(g: Gaussian, x: Array, y: Array) -> tuple[list[Array], list[Array], list[Array]]:
    """Eq. 1 at the pixel centres: w_x per pixel, w_y per row; the exponent of eq. 2 per pixel."""
    dx, dy = x - g.u, y - g.v
    px = [g.p * (dx + (i + 0.5)) for i in range(WIDTH)]
    qy = [g.q * (dy + (j + 0.5)) for j in range(HEIGHT)]
    wy = [g.r * (dy + (j + 0.5)) for j in range(HEIGHT)]
    wx = [px[i] + qy[j] for j in range(HEIGHT) for i in range(WIDTH)]
    base = [dr.fma(-wy[j], wy[j], g.lo) for j in range(HEIGHT)]
    return wx, wy, [dr.fma(-wx[n], wx[n], base[n // WIDTH]) for n in range(PIXELS)]
