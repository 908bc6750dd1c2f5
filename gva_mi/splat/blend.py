"""Front-to-back compositing of the tiles' lists: forward, adjoint and tangent (paper, Eq. 3).

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

With ``absolute``, two more sums: |v w_x| and |v (q w_x + r w_y)|, over pixels of the absolute
derivatives by u, but for the factors that all pixels share.

Tangent, where d_ marks tangents and ln2 is of the base in eq. 2:

(7)  d_w     = (d_p d_x + d_q d_y - p d_u_x - q d_u_y, d_r d_y - r d_u_y)
     d_alpha = ln2 alpha (d_lo - 2 w . d_w);  0 where alpha is clamped
     d_T_{i+1} = d_T_i (1 - alpha) - T_i d_alpha
     d_y_k   = sum_i (d_T_i alpha + T_i d_alpha) f_k + T_i alpha d_f_k  + d_T background_k + ...

T and D are the whole state of a pixel. Every pair writes a *slot* of its own, and ``sum_slots``
adds a Gaussian's slots in a fixed order: no atomics, the same bits at every run and for any number
of threads.

One SIMD lane is one tile and walks its own list (pixels.py). A stopped pixel has a negative T.
"""

from __future__ import annotations

import math

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat import packets
from gva_mi.splat.frozen import Frozen
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.pixels import (
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
from gva_mi.splat.project import MOMENTS
from gva_mi.splat.tiles import HEIGHT, WIDTH, Grid, Lists

UNROLL = 2  # Gaussians per turn of the loop: LLVM spills the 160 loop variables otherwise


@Frozen
def blend(
    rows: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Array],
    planes: Planes,
    *,
    options: SplatOptions,
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
    x, y = corner(lists, grid, F)
    least = math.log2(options.alpha_min)

    # pixels outside the picture have stopped before they start
    in_x = [x + i < F(grid.width) for i in range(WIDTH)]
    in_y = [y + j < F(grid.height) for j in range(HEIGHT)]
    T = [dr.select(a & b, F(1), F(-1)) for b in in_y for a in in_x]
    C = [x * 0 for _ in range(n * PIXELS)]

    def body(k: Array, alive: Array, *state: Array) -> tuple[Array, ...]:
        T, C = list(state[:PIXELS]), list(state[PIXELS:])
        for turn in range(UNROLL):
            g = load(rows, n, lists.ids, k + turn, lists.end)
            lines = [PixelRow.of(g, x, y, j) for j in range(HEIGHT)]
            for i in range(PIXELS):
                row = lines[i // WIDTH]
                exponent = row.exponent(row.wx(PLACES[i % WIDTH]))
                alpha = smaller(exp2(exponent), options.alpha_max)
                alpha = dr.select(exponent >= least, alpha, 0)
                weight = alpha * T[i]
                rest = T[i] - weight
                ok = rest > options.transmittance_min
                weight = dr.select(ok, weight, 0)
                T[i] = dr.select(ok, rest, -dr.abs(T[i]))
                for c in range(n):
                    C[n * i + c] = dr.fma(weight, g.f[c], C[n * i + c])
        greatest = T[0]
        for i in range(1, PIXELS):
            greatest = larger(greatest, T[i])
        return (k + UNROLL, greatest > 0, *T, *C)

    alive = lists.start < lists.end
    state = (U(lists.start), alive, *T, *C)
    k, _, *state = dr.while_loop(
        state, lambda k, alive, *_: (k < lists.end) & alive, body, mode="symbolic", compress=False
    )
    T, C = [dr.abs(t) for t in state[:PIXELS]], state[PIXELS:]
    for j, index in enumerate(pixel_rows(lists, grid)):
        row = range(j * WIDTH, (j + 1) * WIDTH)
        color = [dr.fma(T[i], background[c], C[n * i + c]) for i in row for c in range(channels)]
        packets.store_rows(planes.color, color, index, lists.real)
        packets.store_rows(planes.alpha, [1 - T[i] for i in row], index, lists.real)
        packets.store_rows(planes.depth, [C[n * i + channels] for i in row], index, lists.real)
    stop = dr.minimum(k, lists.end)
    dr.eval(planes, stop)
    return planes, stop


@Frozen
def blend_adjoint(
    rows: packets.Packets,
    lists: Lists,
    stop: Array,
    grid: Grid,
    planes: Planes,
    grad: Planes,
    slots: packets.Packets,
    grad_background: Array,
    *,
    channels: int,
    options: SplatOptions,
    absolute: bool,
) -> tuple[packets.Packets, Array]:
    """Eq. 5-6, lane per tile: one slot per pair, and each lane's share of grad_background.

    Args:
        rows, lists, grid, options, planes, stop: as :func:`blend` took and returned them.
        channels: D.
        absolute: whether the slots hold the two absolute sums.
        grad: dL/dy; the depth may be None.
        slots: memory for the pairs' slots: MOMENTS columns, two if ``absolute``, D, one if depth.
        grad_background: memory for D floats per lane.
    """
    F = type(rows[0])
    U = type(lists.tile)
    x, y = corner(lists, grid, F)
    least = math.log2(options.alpha_min)
    n = channels if grad.depth is None else channels + 1

    G, D = [], []
    for index in pixel_rows(lists, grid):
        row = lambda plane, width, index=index: packets.load_rows(plane, width, index)
        color, gc = (row(p.color, channels * WIDTH) for p in (planes, grad))
        alpha, h = (row(p.alpha, WIDTH) for p in (planes, grad))
        for i in range(WIDTH):
            g = gc[i * channels : (i + 1) * channels]
            G.append(g)
            behind = (alpha[i] - 1) * h[i]
            for c in range(channels):
                behind = dr.fma(color[i * channels + c], g[c], behind)
            D.append(behind)
        if grad.depth is not None:
            depth, gd = (row(p.depth, WIDTH) for p in (planes, grad))
            for i in range(-WIDTH, 0):
                G[i].append(gd[i])
                D[i] = dr.fma(depth[i], gd[i], D[i])
    T = [x * 0 + 1 for _ in range(PIXELS)]  # pixels outside the picture have no gradient

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        T, D = list(state[:PIXELS]), list(state[PIXELS:])
        for step in range(UNROLL):
            g = load(rows, channels + 1, lists.ids, k + step, lists.end)
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
                        alpha = dr.select(exponent >= least, alpha, 0)
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
                        if absolute:
                            ax = _add(ax, dr.abs(v * wx))
                            ay = _add(ay, dr.abs(v * (g.q * wx + g.r * line.wy)))
                        pair.append(v)
                    both, turn = pair[0] + pair[1], pair[1] - pair[0]
                    s0, s1, s2 = _add(s0, both), _fma(turn, e, s1), _fma(both, e * e, s2)
                ps1, vy = g.p * s1, s0 * line.wy
                sx = dr.fma(line.middle, s0, ps1)
                m0, mx, my = _add(m0, s0), _add(mx, sx), _add(my, vy)
                mxx = _add(mxx, dr.fma(line.middle, sx + ps1, g.p * g.p * s2))
                mxy, myy = _fma(sx, line.wy, mxy), _fma(vy, line.wy, myy)
            slot = [m0, mx, my, mxx, mxy, myy, *((ax, ay) if absolute else ()), *grad_f]
            packets.store(slots, slot, k + step, k + step < lists.end)
        return (k + UNROLL, *T, *D)

    state = (U(lists.start), *T, *D)
    state = dr.while_loop(state, lambda k, *_: k < stop, body, mode="symbolic", compress=False)
    T = [dr.abs(t) for t in state[1 : 1 + PIXELS]]
    share = [sum(T[i] * G[i][c] for i in range(PIXELS)) for c in range(channels)]
    packets.store_rows(grad_background, share, dr.arange(U, dr.width(lists.tile)), lists.real)

    def skip(k: Array) -> tuple[Array]:
        packets.store(slots, [x * 0] * (MOMENTS + 2 * absolute + n), k)
        return (k + 1,)

    dr.while_loop((U(stop),), lambda k: k < lists.end, skip, mode="symbolic", compress=False)
    dr.eval(slots, grad_background)
    return slots, grad_background


@Frozen
def blend_tangent(
    rows: packets.Packets,
    drows: packets.Packets,
    lists: Lists,
    stop: Array,
    grid: Grid,
    background: list[Array],
    dbackground: list[Array],
    dplanes: Planes,
    *,
    options: SplatOptions,
) -> Planes:
    """Eq. 7, lane per tile.

    Args:
        rows, lists, grid, background, options, stop: as :func:`blend` took and returned them.
        drows, dbackground: tangents.
        dplanes: memory for the picture's tangent.
    """
    F = type(rows[0])
    U = type(lists.tile)
    channels = len(background)
    n = channels + 1
    x, y = corner(lists, grid, F)
    least, ln2 = math.log2(options.alpha_min), math.log(2.0)
    T = [x * 0 + 1 for _ in range(PIXELS)]
    dT = [x * 0 for _ in range(PIXELS)]
    dC = [x * 0 for _ in range(n * PIXELS)]

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        T, dT, dC = list(state[:PIXELS]), list(state[PIXELS : 2 * PIXELS]), state[2 * PIXELS :]
        dC = list(dC)
        g, d = (load(columns, n, lists.ids, k, lists.end) for columns in (rows, drows))
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
            rest = T[i] - weight
            ok = rest > options.transmittance_min
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
        packets.store_rows(dplanes.depth, [dC[n * i + channels] for i in row], index, lists.real)
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


def _add(a: Array, b: Array) -> Array:
    return b if a is None else a + b


def _fma(a: Array, b: Array, c: Array) -> Array:
    return a * b if c is None else dr.fma(a, b, c)
