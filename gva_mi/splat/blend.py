"""Front-to-back compositing of the tiles' lists: forward and adjoint (paper, Eq. 3).

Per pixel, over the Gaussians i of its tile's list in depth order, with d_i = pixel centre - u_i and
L_i, lo_i of project.py:

(1)  w_i     = L_i d_i = (p d_x + q d_y, r d_y)
(2)  alpha_i = min(alpha_max, 2^(lo_i - |w_i|^2));  0 where that is below alpha_min
(3)  T_0 = 1,  T_{i+1} = T_i (1 - alpha_i);  stop before T_{i+1} falls to transmittance_min
(4)  y_k     = sum_i T_i alpha_i f_ik + T background_k,   alpha = 1 - T,   T the last one

The product of the paper's Eq. 3 includes i itself; it must not (T_i = prod_{j<i}). The features f
are the channels of the colour and, last, the depth, whose background is 0.

Adjoint, replayed front to back, from g_k = dL/dy_k and h = dL/dalpha:

(5)  D_i = sum_k y_k g_k - T h - sum_{j<=i} T_j alpha_j (f_j . g)     what lies behind i
     v_i = alpha_i (T_i (f_i . g) - D_i / (1 - alpha_i))              dL/dln alpha_i; 0 if clamped
(6)  m0 = sum v,  m1 = sum v w,  m2 = sum v w w^T,  grad_f_k = sum T alpha g_k
     over the tile's pixels, for every pair (tile, Gaussian);  grad_background_k = sum T g_k

T and D are the whole state of a pixel. Every pair writes a *slot* of its own, and ``sum_slots``
adds a Gaussian's slots in a fixed order: no atomics, the same bits at every run and for any number
of threads.

One SIMD lane is one tile. Its 32 pixels are unrolled in the trace, and every lane walks its own
list: no operation crosses lanes. A stopped pixel has a negative T. Pictures are planes padded to
whole tiles, so that a row of a tile is one packet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat import packets
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


def _max(a: Array, b: Array) -> Array:
    return dr.select(a > b, a, b)


def _min(a: Array, b: Array) -> Array:
    return dr.select(a < b, a, b)


def _corner(lists: Lists, grid: Grid, F: type) -> tuple[Array, Array]:
    """The tile's left and upper border, px."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    return F((lists.tile - row * columns) * WIDTH), F(row * HEIGHT)


def _pixel_rows(lists: Lists, grid: Grid) -> list[Array]:
    """Index of each of the tile's rows of pixels, counted in rows of a tile's width."""
    columns = type(lists.tile)(grid.columns)
    row = lists.tile // columns
    first = row * (columns * HEIGHT) + (lists.tile - row * columns)
    return [first + columns * j for j in range(HEIGHT)]


@dataclass(frozen=True)
class _Gaussian:
    u: Array
    v: Array
    p: Array
    q: Array
    r: Array
    lo: Array
    f: list[Array]


def _load(rows: packets.Packets, features: int, ids: Array, k: Array, end: Array) -> _Gaussian:
    """Pair ``k``; past the end of the list a Gaussian that no pixel sees."""
    inside = k < end
    gaussian = dr.gather(type(ids), ids, k, active=inside)
    u, v, p, q, r, lo, *f = packets.load(rows, GEOMETRY + features, gaussian)
    return _Gaussian(u, v, p, q, r, dr.select(inside, lo, -1e30), f)


def _whitened(g: _Gaussian, x: Array, y: Array) -> tuple[list[Array], list[Array], list[Array]]:
    """Eq. 1 at the pixel centres: w_x per pixel, w_y per row; the exponent of eq. 2 per pixel."""
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
    background: list[Array],
    options: SplatOptions,
    planes: Planes,
) -> tuple[Planes, Array]:
    """Eq. 1-4, lane per tile.

    Args:
        rows: projected Gaussians.
        lists: the tiles' lists.
        grid: the picture.
        background: one array of size one per colour channel.
        options: cut-offs.
        planes: memory for the picture.

    Returns:
        The picture, and where in ``ids`` each lane stopped.
    """
    F = type(rows[0])
    U = type(lists.tile)
    channels = len(background)
    n = channels + 1  # the features: depth is the last
    x, y = _corner(lists, grid, F)
    least = math.log2(options.alpha_min)

    # pixels outside the picture have stopped before they start
    in_x = [x + i < F(grid.width) for i in range(WIDTH)]
    in_y = [y + j < F(grid.height) for j in range(HEIGHT)]
    T = [dr.select(a & b, F(1), F(-1)) for b in in_y for a in in_x]
    C = [x * 0 for _ in range(n * PIXELS)]

    def body(k: Array, alive: Array, *state: Array) -> tuple[Array, ...]:
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
        color = [dr.fma(T[i], background[c], C[n * i + c]) for i in row for c in range(channels)]
        packets.store_rows(planes.color, color, index, lists.real)
        packets.store_rows(planes.alpha, [1 - T[i] for i in row], index, lists.real)
        packets.store_rows(planes.depth, [C[n * i + channels] for i in row], index, lists.real)
    stop = dr.minimum(k, lists.end)
    dr.eval(planes, stop)
    return planes, stop


@dr.freeze(limit=64, warn_after=1000)
def blend_adjoint(
    rows: packets.Packets,
    lists: Lists,
    stop: Array,
    grid: Grid,
    channels: int,
    options: SplatOptions,
    planes: Planes,
    grad: Planes,
    slots: packets.Packets,
    grad_background: Array,
) -> tuple[packets.Packets, Array]:
    """Eq. 5-6, lane per tile: one slot per pair, and each lane's share of grad_background.

    Args:
        rows, lists, grid, options, planes, stop: as :func:`blend` took and returned them.
        channels: D.
        grad: dL/dy; the depth may be None.
        slots: memory for the pairs' slots, MOMENTS + D columns, one more with depth.
        grad_background: memory for D floats per lane.
    """
    F = type(rows[0])
    U = type(lists.tile)
    x, y = _corner(lists, grid, F)
    least = math.log2(options.alpha_min)
    n = channels if grad.depth is None else channels + 1

    G, D = [], []
    for index in _pixel_rows(lists, grid):
        load = lambda plane, width, index=index: packets.load_rows(plane, width, index)
        color, gc = (load(p.color, channels * WIDTH) for p in (planes, grad))
        alpha, h = (load(p.alpha, WIDTH) for p in (planes, grad))
        for i in range(WIDTH):
            g = gc[i * channels : (i + 1) * channels]
            G.append(g)
            behind = (alpha[i] - 1) * h[i]
            for c in range(channels):
                behind = dr.fma(color[i * channels + c], g[c], behind)
            D.append(behind)
        if grad.depth is not None:
            depth, gd = (load(p.depth, WIDTH) for p in (planes, grad))
            for i in range(-WIDTH, 0):
                G[i].append(gd[i])
                D[i] = dr.fma(depth[i], gd[i], D[i])
    T = [x * 0 + 1 for _ in range(PIXELS)]  # pixels outside the picture have no gradient

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        T, D = list(state[:PIXELS]), list(state[PIXELS:])
        for turn in range(UNROLL):
            g = _load(rows, channels + 1, lists.ids, k + turn, lists.end)
            wx, wy, exponent = _whitened(g, x, y)
            grad_f = [None] * n
            m0, mx, my, mxx, mxy, myy = [None] * MOMENTS
            for j in range(HEIGHT):
                s0 = s1 = s2 = None  # sums of v, v w_x, v w_x^2 over a row, where w_y is one number
                for i in range(j * WIDTH, (j + 1) * WIDTH):
                    free = exp2(exponent[i])
                    alpha = _min(free, options.alpha_max)
                    alpha = dr.select(exponent[i] >= least, alpha, 0)
                    weight = alpha * T[i]
                    rest = T[i] - weight
                    ok = rest > options.transmittance_min
                    weight = dr.select(ok, weight, 0)
                    fg = g.f[0] * G[i][0]
                    for c in range(1, n):
                        fg = dr.fma(g.f[c], G[i][c], fg)
                    D[i] = dr.fma(-weight, fg, D[i])
                    v = alpha * dr.fma(T[i], fg, -D[i] / (1 - alpha))
                    v = dr.select(ok & (free <= options.alpha_max), v, 0)
                    T[i] = dr.select(ok, rest, -dr.abs(T[i]))
                    for c in range(n):
                        grad_f[c] = _fma(weight, G[i][c], grad_f[c])
                    vw = v * wx[i]
                    s0, s1, s2 = _add(s0, v), _add(s1, vw), _fma(vw, wx[i], s2)
                vy = s0 * wy[j]
                m0, mx, my, mxx = _add(m0, s0), _add(mx, s1), _add(my, vy), _add(mxx, s2)
                mxy, myy = _fma(s1, wy[j], mxy), _fma(vy, wy[j], myy)
            slot = [m0, mx, my, mxx, mxy, myy, *grad_f]
            packets.store(slots, slot, k + turn, k + turn < lists.end)
        return (k + UNROLL, *T, *D)

    state = (U(lists.start), *T, *D)
    state = dr.while_loop(state, lambda k, *_: k < stop, body, mode="symbolic", compress=False)
    T = [dr.abs(t) for t in state[1 : 1 + PIXELS]]
    share = [sum(T[i] * G[i][c] for i in range(PIXELS)) for c in range(channels)]
    packets.store_rows(grad_background, share, dr.arange(U, dr.width(lists.tile)), lists.real)

    def skip(k: Array) -> tuple[Array]:
        packets.store(slots, [x * 0] * (MOMENTS + n), k)
        return (k + 1,)

    dr.while_loop((U(stop),), lambda k: k < lists.end, skip, mode="symbolic", compress=False)
    dr.eval(slots, grad_background)
    return slots, grad_background


def sum_slots(lists: Lists, slots: packets.Packets, columns: int) -> list[Array]:
    """Each Gaussian's slots added up, one after the other."""
    zero = dr.zeros(type(slots[0]), dr.width(lists.counts))

    def body(k: Array, *sums: Array) -> tuple[Array, ...]:
        slot = packets.load(slots, columns, dr.gather(type(k), lists.slots, k))
        return (k + 1, *(a + b for a, b in zip(sums, slot, strict=True)))

    last = lists.first + lists.counts
    state = (type(lists.first)(lists.first), *(zero * 1 for _ in range(columns)))
    state = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic", compress=False)
    return list(state[1:])


def _add(a: Array, b: Array) -> Array:
    return b if a is None else a + b


def _fma(a: Array, b: Array, c: Array) -> Array:
    return a * b if c is None else dr.fma(a, b, c)
