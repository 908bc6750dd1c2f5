"""Front-to-back compositing of the tiles' lists: forward and adjoint (paper, Eq. 3).

Per pixel, with the Gaussians i of its tile's list in depth order, d_i = pixel centre - u_i, and L_i, lo_i of project.py:

(1)  w_i     = L_i d_i = (p d_x + q d_y, r d_y)
(2)  alpha_i = min(alpha_max, 2^(lo_i - |w_i|^2)),  0 where below alpha_min
(3)  T_0 = 1,  T_{i+1} = T_i (1 - alpha_i);  the pixel stops before T_{i+1} falls to transmittance_min
(4)  y_k     = sum_i T_i alpha_i f_ik + T background_k,  T the last one;   alpha = 1 - T

The paper's product in Eq. 3 includes i itself; it must not (T_i = prod_{j<i}). The features f are the colour's channels
and, last, the depth (whose background is 0).

Adjoint, replayed front to back, from g_k = dL/dy_k and h = dL/dalpha:

(5)  D_i   = sum_k y_k g_k - T h - sum_{j<=i} T_j alpha_j (f_j . g)       what lies behind i, as seen by the loss
     v_i   = alpha_i (T_i (f_i . g) - D_i / (1 - alpha_i))                dL/dln alpha_i; 0 where clamped
(6)  per pair (tile, Gaussian), over the tile's pixels:  m0 = sum v,  m1 = sum v w,  m2 = sum v w w^T,
     grad_f_k = sum T alpha g_k

The state per pixel is T and D alone. Every pair writes a slot of its own, and :func:`gva_mi.splat.render` sums a
Gaussian's slots in a fixed order: no atomics, the same bits at every run and for any number of threads.

One SIMD lane is one tile: its 32 pixels are unrolled in the trace, and every lane walks its own list, so no
operation crosses lanes. A stopped pixel is marked by a negative T.

Images are held in whole tiles, (4 rows, 8 columns) in row-major order, so that a row of a tile is one packet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from gva_mi.splat import packets, tiles
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.project import GEOMETRY, MOMENTS
from gva_mi.splat.tiles import HEIGHT, WIDTH, Grid, Lists

PIXELS = WIDTH * HEIGHT
UNROLL = 2  # Gaussians per turn of the loop: LLVM spills the 160 loop variables otherwise

# 2^f on [-1/2, 1/2], relative error 2e-7
EXP2 = (1.0, 0.69314720, 0.24022651, 0.05550357, 0.00961814, 0.00133335)
ROUND = 12582912.0  # 1.5 * 2^23: adding it rounds a float32 to an integer in the low bits


@dataclass(frozen=True)
class Planes:
    """The picture, padded to whole tiles; flat arrays."""

    features: Any  # (rows, columns, D) colour, background blended in
    alpha: Any  # (rows, columns)
    depth: Any  # (rows, columns), or None


def exp2(x: Any) -> Any:
    """2^x for -126 < x < 127: a polynomial in float32, 30 % faster than ``dr.exp2``."""
    if dr.is_double_v(x):
        return dr.exp2(x)
    F, I = type(x), dr.int32_array_t(type(x))
    shifted = x + ROUND
    fraction = x - (shifted - ROUND)
    value = F(EXP2[-1])
    for c in EXP2[-2::-1]:
        value = dr.fma(value, fraction, c)
    bits = dr.reinterpret_array(I, value) + (dr.reinterpret_array(I, shifted) << 23)
    return dr.reinterpret_array(F, bits)


def _max(a: Any, b: Any) -> Any:
    return dr.select(a > b, a, b)


def _min(a: Any, b: Any) -> Any:
    return dr.select(a < b, a, b)


def _corner(lists: Lists, grid: Grid, F: type) -> tuple[Any, Any]:
    """The tile's left and upper border, px."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    return F((lists.tile - row * columns) * WIDTH), F(row * HEIGHT)


def _pixel_rows(lists: Lists, grid: Grid) -> list[Any]:
    """Index of each of the tile's rows of pixels, counted in rows of a tile's width."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    first = row * (columns * HEIGHT) + (lists.tile - row * columns)
    return [first + columns * j for j in range(HEIGHT)]


@dataclass(frozen=True)
class _Gaussian:
    u: Any
    v: Any
    p: Any
    q: Any
    r: Any
    lo: Any
    f: list[Any]


def _load(rows: packets.Packets, features: int, ids: Any, k: Any, end: Any) -> _Gaussian:
    """Pair ``k``; past the end of the list a Gaussian that no pixel sees."""
    inside = k < end
    gaussian = dr.gather(type(ids), ids, k, active=inside)
    u, v, p, q, r, lo, *f = packets.load(rows, GEOMETRY + features, gaussian)
    return _Gaussian(u, v, p, q, r, dr.select(inside, lo, -1e30), f)


def _whitened(g: _Gaussian, x: Any, y: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """Eq. 1 at the pixel centres: w_x per pixel, w_y per row, and the exponent of eq. 2 per pixel."""
    dx, dy = x - g.u, y - g.v
    px = [g.p * (dx + (i + 0.5)) for i in range(WIDTH)]
    qy = [g.q * (dy + (j + 0.5)) for j in range(HEIGHT)]
    wy = [g.r * (dy + (j + 0.5)) for j in range(HEIGHT)]
    wx = [px[i] + qy[j] for j in range(HEIGHT) for i in range(WIDTH)]
    base = [dr.fma(-wy[j], wy[j], g.lo) for j in range(HEIGHT)]
    return wx, wy, [dr.fma(-wx[n], wx[n], base[n // WIDTH]) for n in range(PIXELS)]


@dr.freeze(limit=64, warn_after=1000)
def blend(
    rows: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Any],
    options: SplatOptions,
    planes: Planes,
) -> tuple[Planes, Any]:
    """Eq. 1-4, lane per tile.

    Args:
        rows: projected Gaussians. lists: the tiles' lists. grid: the picture.
        background: one array of size one per colour channel.
        options: cut-offs.
        planes: memory for the picture.

    Returns:
        The picture, and where in ``ids`` each lane stopped.
    """
    F = type(rows[0])
    U = type(lists.tile)
    D = len(background)
    x, y = _corner(lists, grid, F)
    least = math.log2(options.alpha_min)
    n = D + 1

    inside_x = [x + i < F(grid.width) for i in range(WIDTH)]
    inside_y = [y + j < F(grid.height) for j in range(HEIGHT)]
    T = [dr.select(inside_x[i] & inside_y[j], F(1), F(-1)) for j in range(HEIGHT) for i in range(WIDTH)]
    C = [x * 0 for _ in range(n * PIXELS)]

    def body(k: Any, alive: Any, *state: Any) -> tuple[Any, ...]:
        T, C = list(state[:PIXELS]), list(state[PIXELS:])
        for turn in range(UNROLL):
            g = _load(rows, n, lists.ids, k + turn, lists.end)
            _, _, exponent = _whitened(g, x, y)
            for i in range(PIXELS):
                alpha = _min(exp2(exponent[i]), options.alpha_max)
                alpha = dr.select(exponent[i] >= least, alpha, 0)
                weight = alpha * T[i]
                rest = T[i] - weight
                ok = rest > options.transmittance_min
                weight = dr.select(ok, weight, 0)
                T[i] = dr.select(ok, rest, -dr.abs(T[i]))
                for c in range(n):
                    C[n * i + c] = dr.fma(weight, g.f[c], C[n * i + c])
        greatest = T[0]
        for i in range(1, PIXELS):
            greatest = _max(greatest, T[i])
        return (k + UNROLL, greatest > 0, *T, *C)

    alive = lists.start < lists.end
    state = (U(lists.start), alive, *T, *C)
    k, _, *state = dr.while_loop(
        state, lambda k, alive, *_: (k < lists.end) & alive, body, mode="symbolic", compress=False
    )
    T, C = [dr.abs(t) for t in state[:PIXELS]], state[PIXELS:]
    for j, index in enumerate(_pixel_rows(lists, grid)):
        row = range(j * WIDTH, (j + 1) * WIDTH)
        color = [dr.fma(T[i], background[c], C[n * i + c]) for i in row for c in range(D)]
        # the lanes without a tile share tile 0's address: they must not write
        active = real_lanes(lists)
        packets.store_rows(planes.features, color, index, active)
        packets.store_rows(planes.alpha, [1 - T[i] for i in row], index, active)
        packets.store_rows(planes.depth, [C[n * i + D] for i in row], index, active)
    stop = dr.minimum(k, lists.end)
    dr.eval(planes, stop)
    return planes, stop
