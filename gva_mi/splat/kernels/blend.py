"""Front-to-back compositing of the tiles' lists: forward, adjoint and tangent (paper, Eq. 3).

Per pixel, over the Gaussians i of its tile's list in depth order, with d_i = pixel centre - u_i and
L_i, lo_i of project.py:

(1)  w_i     = L_i d_i = (p d_x + q d_y, r d_y)
(2)  alpha_i = min(alpha_max, 2^(lo_i - |w_i|^2));  0 where that is below alpha_min
(3)  T_0 = 1,  T_{i+1} = T_i (1 - alpha_i);  stop before T_{i+1} falls to transmittance_min, and
     before the first Gaussian that is no nearer than the pixel's limit, if it has one
(4)  y_k     = sum_i T_i alpha_i f_ik + T background_k,   alpha = 1 - T,   T the last one

The product of the paper's Eq. 3 includes i itself; it must not (T_i = prod_{j<i}). The features f
are the channels of the colour and, last, the depth, whose background is 0.

Adjoint, back to front, from g_k = dL/dy_k, h = dL/dalpha, the last T and where the pixel stopped:

(5)  T_i = T_{i+1} / (1 - alpha_i)
     v_i = T_i alpha_i (f_i . g - B_i)                        dL/dln alpha_i; 0 if clamped
     B_{i-1} = B_i + alpha_i (f_i . g - B_i)                  what lies behind i - 1, through g;
                                                              behind the last: background . g - h
(6)  m0 = sum v,  m1 = sum v w,  m2 = sum v w w^T,  grad_f_k = sum T_i alpha g_k
     over the tile's pixels, for every pair (tile, Gaussian);  grad_background_k = sum T g_k

Eq. 5 adds and multiplies what is of one size. From front to back, what lies behind i would be the
whole less what was passed, and behind an opaque Gaussian nothing but the rounding of both.

With ``absolute``, two more sums: |v w_x| and |v (q w_x + r w_y)|, over pixels of the absolute
derivatives by u, but for the factors that all pixels share.

Tangent, where d_ marks tangents and ln2 is of the base in eq. 2:

(7)  d_w     = (d_p d_x + d_q d_y - p d_u_x - q d_u_y, d_r d_y - r d_u_y)
     d_alpha = ln2 alpha (d_lo - 2 w . d_w);  0 where alpha is clamped
     d_T_{i+1} = d_T_i (1 - alpha) - T_i d_alpha
     d_y_k   = sum_i (d_T_i alpha + T_i d_alpha) f_k + T_i alpha d_f_k  + d_T background_k + ...

T and B are the whole state of a pixel. Every pair writes a *slot* of its own, and ``sum_slots``
adds a Gaussian's slots in a fixed order: no atomics, the same bits at every run and for any number
of threads.

One SIMD lane is one tile and walks its own list (pixels.py). A stopped pixel has a negative T.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.pixels import (
    PIXELS,
    PLACES,
    PixelRow,
    Planes,
    corner,
    exp2,
    larger,
    load,
    pixel_rows,
    smaller,
)
from gva_mi.splat.kernels.project import MOMENTS
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists
from gva_mi.splat.options import SplatOptions

UNROLL = 2  # Gaussians per turn of the loop: LLVM spills the 160 loop variables otherwise


@dataclass(frozen=True)
class Trail:
    """What the compositing leaves for its way back; as :class:`Planes`, one number per pixel."""

    T: Array  # the last transmittance of eq. 3
    end: Array  # in ids: where the pixel stopped, one past the last Gaussian that it shows


@dataclass(frozen=True)
class Limit:
    """How far every pixel sees."""

    plane: Array  # m, one number per pixel of the padded picture
    depths: Array  # (N,) m, of the Gaussians


@Frozen
def blend(
    rows: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    *,
    pixels: int,
    depth: bool,
    options: SplatOptions,
) -> tuple[Planes, Trail, Array]:
    """Eq. 1-4, lane per tile.

    Args:
        rows: projected Gaussians.
        lists: the tiles' lists.
        grid: the picture.
        background: one array of size one per colour channel.
        limit: None where pixels see all Gaussians.
        pixels: of the picture, padded to whole tiles.
        depth: whether the last feature is the depth, and its picture is made.
        options: cut-offs.

    Returns:
        The picture, the trail, and where in ``ids`` each lane stopped.
    """
    F = type(rows[0])
    U = type(lists.tile)
    channels = len(background)
    n = channels + depth  # the features
    x, y = corner(lists, grid, F)
    least = math.log2(options.alpha_min)

    # pixels outside the picture have stopped before they start
    in_x = [x + i < F(grid.width) for i in range(WIDTH)]
    in_y = [y + j < F(grid.height) for j in range(HEIGHT)]
    T = [dr.select(a & b, F(1), F(-1)) for b in in_y for a in in_x]
    C = [x * 0 for _ in range(n * PIXELS)]
    ends = [U(0) for _ in range(PIXELS)]
    limits = [] if limit is None else _by_pixel(limit.plane, lists, grid)

    def body(k: Array, alive: Array, *state: Array) -> tuple[Array, ...]:
        T, ends, C = (
            list(state[:PIXELS]),
            list(state[PIXELS : 2 * PIXELS]),
            list(state[2 * PIXELS :]),
        )
        for turn in range(UNROLL):
            g = load(rows, n, lists.ids, k + turn, k + turn < lists.end)
            if limits:
                z = _depth(limit, lists, k + turn)
            lines = [PixelRow.of(g, x, y, j) for j in range(HEIGHT)]
            for i in range(PIXELS):
                row = lines[i // WIDTH]
                exponent = row.exponent(row.wx(PLACES[i % WIDTH]))
                alpha = smaller(exp2(exponent), options.alpha_max)
                alpha = dr.select(exponent >= least, alpha, 0)
                rest = dr.fma(-alpha, T[i], T[i])
                ok = rest > options.transmittance_min
                if limits:
                    ok &= z < limits[i]
                weight = dr.select(ok, alpha * T[i], 0)
                T[i] = dr.select(ok, rest, -dr.abs(T[i]))
                ends[i] = dr.select(ok, k + (turn + 1), ends[i])
                for c in range(n):
                    C[n * i + c] = dr.fma(weight, g.f[c], C[n * i + c])
        greatest = T[0]
        for i in range(1, PIXELS):
            greatest = larger(greatest, T[i])
        return (k + UNROLL, greatest > 0, *T, *ends, *C)

    alive = lists.start < lists.end
    state = (U(lists.start), alive, *T, *ends, *C)
    _, _, *state = dr.while_loop(
        state, lambda k, alive, *_: (k < lists.end) & alive, body, mode="symbolic", compress=False
    )
    T, ends, C = (
        [dr.abs(t) for t in state[:PIXELS]],
        state[PIXELS : 2 * PIXELS],
        state[2 * PIXELS :],
    )
    image = [dr.empty(F, pixels * k) for k in (channels, 1, *[1] * depth)]
    planes = Planes(*image, *[None] * (not depth))
    trail = Trail(dr.empty(F, pixels), dr.empty(U, pixels))
    for j, index in enumerate(pixel_rows(lists, grid)):
        row = range(j * WIDTH, (j + 1) * WIDTH)
        color = [dr.fma(T[i], background[c], C[n * i + c]) for i in row for c in range(channels)]
        packets.store_rows(planes.color, color, index, lists.real)
        packets.store_rows(planes.alpha, [1 - T[i] for i in row], index, lists.real)
        if depth:
            packets.store_rows(planes.depth, [C[n * i + channels] for i in row], index, lists.real)
        packets.store_rows(trail.T, [T[i] for i in row], index, lists.real)
        packets.store_rows(trail.end, [ends[i] for i in row], index, lists.real)
    stop = dr.clip(functools.reduce(larger, ends), lists.start, lists.end)
    dr.eval(planes, trail, stop)
    return planes, trail, stop


@Frozen
def blend_adjoint(
    rows: packets.Packets,
    lists: Lists,
    stop: Array,
    grid: Grid,
    background: list[Array],
    trail: Trail,
    grad: Planes,
    *,
    pairs: int,
    lanes: int,
    depth: bool,
    options: SplatOptions,
    absolute: bool,
) -> tuple[packets.Packets, Array]:
    """Eq. 5-6, lane per tile: one slot per pair, and each lane's share of grad_background.

    Args:
        rows, lists, grid, background, depth, options, trail, stop: as :func:`blend` took and
            returned them.
        absolute: whether the slots hold the two absolute sums.
        grad: dL/dy; its depth may be None.
        pairs, lanes: widths of ``lists.ids`` and ``lists.tile``.

    Returns:
        The pairs' slots: MOMENTS columns, two if ``absolute``, D, one if the loss looks at depth;
        and D floats per lane.
    """
    F = type(rows[0])
    U = type(lists.tile)
    x, y = corner(lists, grid, F)
    least = math.log2(options.alpha_min)
    channels = len(background)
    n = channels if grad.depth is None else channels + 1

    G, B, T, ends = [], [], [], []
    for index in pixel_rows(lists, grid):
        row = lambda plane, width=WIDTH, index=index: packets.load_rows(plane, width, index)
        T, ends = T + row(trail.T), ends + row(trail.end)
        gc, h = row(grad.color, channels * WIDTH), row(grad.alpha)
        gd = [] if grad.depth is None else row(grad.depth)
        for i in range(WIDTH):
            g = gc[i * channels : (i + 1) * channels]
            behind = -h[i]
            for c in range(channels):
                behind = dr.fma(background[c], g[c], behind)
            B.append(behind)
            G.append(g + gd[i : i + 1])
    share = [sum(T[i] * G[i][c] for i in range(PIXELS)) for c in range(channels)]
    share = [dr.select(lists.real, s, 0) for s in share]
    grad_background = dr.empty(F, lanes * channels)
    packets.store_rows(grad_background, share, dr.arange(U, dr.width(lists.tile)))

    columns = MOMENTS + 2 * absolute + n
    slots = [dr.zeros(F, pairs * width) for width in packets.widths(columns)]

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        T, B = list(state[:PIXELS]), list(state[PIXELS:])
        for turn in range(UNROLL):
            here, real = k - (turn + 1), k > lists.start + turn
            g = load(rows, channels + depth, lists.ids, here, real)
            grad_f = [None] * n
            m0, mx, my, mxx, mxy, myy = [None] * MOMENTS
            ax = ay = None
            for j in range(HEIGHT):
                # sums of v, v e, v e^2 over the row, where pixels at e and -e share a product
                line = PixelRow.of(g, x, y, j)
                s0 = s1 = s2 = None
                for left in range(WIDTH // 2):
                    e = -PLACES[left]
                    pair = []
                    for i in (j * WIDTH + left, (j + 1) * WIDTH - 1 - left):
                        wx = line.wx(PLACES[i % WIDTH])
                        exponent = line.exponent(wx)
                        free = exp2(exponent)
                        alpha = smaller(free, options.alpha_max)
                        alpha = dr.select((exponent >= least) & (here < ends[i]), alpha, 0)
                        T[i] = T[i] / (1 - alpha)
                        weight = T[i] * alpha
                        apart = -B[i]
                        for c in range(n):
                            apart = dr.fma(g.f[c], G[i][c], apart)
                        v = dr.select(free <= options.alpha_max, weight * apart, 0)
                        B[i] = dr.fma(alpha, apart, B[i])
                        for c in range(n):
                            grad_f[c] = _fma(weight, G[i][c], grad_f[c])
                        if absolute:
                            ax = _add(ax, dr.abs(v * wx))
                            ay = _add(ay, dr.abs(v * (g.q * wx + g.r * line.wy)))
                        pair.append(v)
                    both, difference = pair[0] + pair[1], pair[1] - pair[0]
                    s0, s1, s2 = _add(s0, both), _fma(difference, e, s1), _fma(both, e * e, s2)
                ps1, vy = g.p * s1, s0 * line.wy
                sx = dr.fma(line.middle, s0, ps1)
                m0, mx, my = _add(m0, s0), _add(mx, sx), _add(my, vy)
                mxx = _add(mxx, dr.fma(line.middle, sx + ps1, g.p * g.p * s2))
                mxy, myy = _fma(sx, line.wy, mxy), _fma(vy, line.wy, myy)
            slot = [m0, mx, my, mxx, mxy, myy, *((ax, ay) if absolute else ()), *grad_f]
            packets.store(slots, slot, here, real)
        return (dr.select(k > UNROLL, k - UNROLL, 0), *T, *B)

    state = (U(stop), *T, *B)
    start = lists.start
    dr.while_loop(state, lambda k, *_: k > start, body, mode="symbolic", compress=False)
    dr.eval(slots, grad_background)
    return slots, grad_background


@Frozen
def blend_tangent(
    rows: packets.Packets,
    drows: packets.Packets,
    lists: Lists,
    stop: Array,
    trail: Trail,
    grid: Grid,
    background: list[Array],
    dbackground: list[Array],
    dplanes: Planes,
    *,
    depth: bool,
    options: SplatOptions,
) -> Planes:
    """Eq. 7, lane per tile.

    Args:
        rows, lists, grid, background, depth, options, trail, stop: as :func:`blend` took and
            returned them.
        drows, dbackground: tangents.
        dplanes: memory for the picture's tangent.
    """
    F = type(rows[0])
    U = type(lists.tile)
    channels = len(background)
    n = channels + depth
    x, y = corner(lists, grid, F)
    least, ln2 = math.log2(options.alpha_min), math.log(2.0)
    T = [x * 0 + 1 for _ in range(PIXELS)]
    dT = [x * 0 for _ in range(PIXELS)]
    dC = [x * 0 for _ in range(n * PIXELS)]
    ends = _by_pixel(trail.end, lists, grid)

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        T, dT, dC = list(state[:PIXELS]), list(state[PIXELS : 2 * PIXELS]), state[2 * PIXELS :]
        dC = list(dC)
        g, d = (load(columns, n, lists.ids, k, k < lists.end) for columns in (rows, drows))
        lines = [PixelRow.of(g, x, y, j) for j in range(HEIGHT)]
        for i in range(PIXELS):
            row, column = divmod(i, WIDTH)
            line = lines[row]
            wx = line.wx(PLACES[column])
            exponent = line.exponent(wx)
            dx, dy = x - g.u + (column + 0.5), y - g.v + (row + 0.5)
            dwx = d.p * dx + d.q * dy - g.p * d.u - g.q * d.v
            dwy = d.r * dy - g.r * d.v
            free = exp2(exponent)
            alpha = smaller(free, options.alpha_max)
            alpha = dr.select(exponent >= least, alpha, 0)
            dalpha = ln2 * alpha * (d.lo - 2 * (wx * dwx + line.wy * dwy))
            dalpha = dr.select(free <= options.alpha_max, dalpha, 0)
            weight, dweight = alpha * T[i], dT[i] * alpha + T[i] * dalpha
            rest = dr.fma(-alpha, T[i], T[i])
            ok = k < ends[i]
            weight, dweight = dr.select(ok, weight, 0), dr.select(ok, dweight, 0)
            T[i], dT[i] = dr.select(ok, rest, -dr.abs(T[i])), dT[i] - dweight
            for c in range(n):
                dC[n * i + c] += dweight * g.f[c] + weight * d.f[c]
        return (k + 1, *T, *dT, *dC)

    state = (U(lists.start), *T, *dT, *dC)
    state = dr.while_loop(state, lambda k, *_: k < stop, body, mode="symbolic", compress=False)
    T, dT = [dr.abs(t) for t in state[1 : 1 + PIXELS]], state[1 + PIXELS : 1 + 2 * PIXELS]
    dC = state[1 + 2 * PIXELS :]
    for j, index in enumerate(pixel_rows(lists, grid)):
        row = range(j * WIDTH, (j + 1) * WIDTH)
        dcolor = [
            dC[n * i + c] + dT[i] * background[c] + T[i] * dbackground[c]
            for i in row
            for c in range(channels)
        ]
        packets.store_rows(dplanes.color, dcolor, index, lists.real)
        packets.store_rows(dplanes.alpha, [-dT[i] for i in row], index, lists.real)
        if depth:
            deep = [dC[n * i + channels] for i in row]
            packets.store_rows(dplanes.depth, deep, index, lists.real)
    dr.eval(dplanes)
    return dplanes


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


def _by_pixel(plane: Array, lists: Lists, grid: Grid) -> list[Array]:
    """The numbers of the tile's pixels."""
    rows = (packets.load_rows(plane, WIDTH, index) for index in pixel_rows(lists, grid))
    return [number for row in rows for number in row]


def _depth(limit: Limit, lists: Lists, k: Array) -> Array:
    """Of the Gaussian of pair ``k``."""
    gaussian = dr.gather(type(k), lists.ids, k, active=k < lists.end)
    return dr.gather(type(limit.depths), limit.depths, gaussian)


def _add(a: Array, b: Array) -> Array:
    return b if a is None else a + b


def _fma(a: Array, b: Array, c: Array) -> Array:
    return a * b if c is None else dr.fma(a, b, c)
