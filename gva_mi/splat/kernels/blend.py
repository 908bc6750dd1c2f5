"""Front-to-back compositing of the tiles' lists: the loops around the steps of pixel.py.

One SIMD lane is one tile and iterates over its own list: forward from front to back, in the adjoint
from where its pixels stopped back to the front. Every pair (tile, Gaussian) writes a *slot* of its
own, the sums of eq. 16 over the tile's pixels, and ``sum_slots`` adds a Gaussian's slots in a fixed
order: no atomics, the same bits in every run and for any number of threads.
"""

from __future__ import annotations

import functools

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.jit.frozen import Frozen
from gva_mi.splat.kernels.pixel import (
    MIRRORED,
    PIXELS,
    PLACES,
    Alpha,
    Pixel,
    PixelAdjoint,
    PixelRow,
    PixelTangent,
    larger,
    w_tangent,
)
from gva_mi.splat.kernels.records import PairGradient, RecordFormat, Splat
from gva_mi.splat.kernels.tile_memory import (
    PARTS,
    Limit,
    Memory,
    Place,
    Planes,
    Rows,
    SavedPixels,
    TileIterator,
    Window,
    for_each_part,
    for_each_row,
    load_pixels,
    load_splat,
    store_pixels,
)
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists
from gva_mi.splat.kernels.vectors import Sym2, Vec2, plus
from gva_mi.splat.options import SplatOptions

# Gaussians per turn of the loops. Each turn loads and stores the state of its tile's pixels, which
# does not fit into the registers. Chosen: more of them cost code and time to compile.
UNROLL, UNROLL_ADJOINT = 6, 2


@Frozen
def blend(
    splats: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    *,
    pixels: int,
    format: RecordFormat,
    options: SplatOptions,
) -> tuple[Planes, SavedPixels, Array]:
    """Eq. 11-14, one lane per tile.

    Args:
        splats: the Gaussians in the picture.
        lists: the tiles' lists.
        grid: the picture.
        background: one array of size one per colour channel.
        limit: None if pixels show all Gaussians.
        pixels: number to allocate, no fewer than the picture has, padded to whole tiles.
        format: of the splats; with a depth, the depth image is made too.
        options: cut-offs.

    Returns:
        The picture, its ``SavedPixels``, and where in ``ids`` each lane stopped.
    """
    F, U = type(splats[0]), type(lists.tile)
    window = Window.of(lists, grid, F)
    zeros = [window.x * 0 for _ in range(format.channels + format.depth)]
    # pixels outside the picture have stopped before they start
    tile = store_pixels([[dr.select(i, F(1), F(-1)), U(0), *zeros] for i in window.inside(grid, F)])
    limits = [] if limit is None else store_pixels([[z] for z in window.load(limit.plane)])

    places = lambda k, j: (k + j, k + j < lists.end)
    iterator = TileIterator(splats, format, lists.ids, places, UNROLL)

    def body(k: Array, alive: Array, tile: Memory, limits: Memory, *ahead: Array) -> tuple:
        gaussians, ahead = iterator.next(k, ahead)
        features = [g.features for g in gaussians]
        depths = [limit.of_pair(lists, k + turn) for turn in range(UNROLL if limits else 0)]

        def step(place: Place, pixels: list[Pixel], limits: list[Array]) -> list[Pixel]:
            j, places = place
            rows = [PixelRow.of(g, window.x, window.y, j) for g in gaussians]
            out = []
            for i, (e, pixel) in enumerate(zip(places, pixels, strict=True)):
                alphas = (Alpha.at(row, e, options).value for row in rows)
                within = [z < limits[i] for z in depths] or None
                out.append(pixel.step(alphas, features, k, within, options))
            return out

        tile, limits, greatest = for_each_part(step, tile, limits, F)
        return (k + UNROLL, greatest > 0, tile, limits, *ahead)

    alive, start = lists.start < lists.end, U(lists.start)
    state = (start, alive, tile, limits, *iterator.begin(start))
    state = dr.while_loop(
        state, lambda k, alive, *_: (k < lists.end) & alive, body, mode="symbolic", compress=False
    )
    parts = [load_pixels(state[2], part) for part in range(PARTS)]
    tile = [Pixel(T, end, y) for part in parts for T, end, *y in part]
    window = Window.of(lists, grid, F)  # again: otherwise its rows occupy registers during the loop
    planes = Planes.empty(F, format, pixels)
    saved_pixels = SavedPixels(dr.empty(F, pixels), dr.empty(U, pixels))
    last = [dr.abs(pixel.T) for pixel in tile]
    color = [
        [dr.fma(T, behind, pixel.y[c]) for c, behind in enumerate(background)]
        for T, pixel in zip(last, tile, strict=True)
    ]
    window.store_channels(planes.color, color)
    window.store(planes.alpha, [1 - T for T in last])
    if format.depth:
        window.store(planes.depth, [pixel.y[-1] for pixel in tile])
    window.store(saved_pixels.T, last)
    window.store(saved_pixels.end, [pixel.end for pixel in tile])
    ends = functools.reduce(larger, [pixel.end for pixel in tile])
    stop = dr.clip(ends, lists.start, lists.end)
    dr.eval(planes, saved_pixels, stop)
    return planes, saved_pixels, stop


@Frozen
def blend_adjoint(
    splats: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Array],
    saved_pixels: SavedPixels,
    grad: Planes,
    *,
    pairs: int,
    lanes: int,
    format: RecordFormat,
    slot_format: RecordFormat,
    options: SplatOptions,
) -> tuple[packets.Packets, Array]:
    """Eq. 15-16, one lane per tile: a slot per pair, and each lane's share of grad_background.

    Args:
        splats, grid, background, format, options: as :func:`blend` took them.
        lists: the part of them that it composited (``tiles.composited``).
        saved_pixels: as :func:`blend` returned them.
        grad: dL/dy; its alpha and depth may be None.
        pairs, lanes: widths of ``lists.ids`` and ``lists.tile``.
        slot_format: of the slots; without a depth if no loss depends on it, and without moments or
            channels if the gradients made of them are not requested.

    Returns:
        The pairs' slots, and D floats per lane.
    """
    F, U = type(splats[0]), type(lists.tile)
    window = Window.of(lists, grid, F)
    by_y, tile = _gradient_of_sums(window, grad, background, saved_pixels, slot_format.moments)
    ends = window.load(saved_pixels.end)
    grad_background = dr.empty(F, lanes * len(background))
    share = [
        sum(pixel.T * g[c] for pixel, g in zip(tile, by_y, strict=True))
        for c in range(len(background))
    ]
    share = [dr.select(lists.real, s, 0) for s in share]
    packets.store_rows(grad_background, share, dr.arange(U, dr.width(lists.tile)))
    columns = PairGradient.columns(slot_format)
    slots = [dr.empty(F, pairs * width) for width in packets.widths(columns)]
    _clear_unseen(slots, lists, slot_format)

    back = lambda k, j: (k - (j + 1), k > lists.start + j)
    iterator = TileIterator(splats, format, lists.ids, back, UNROLL_ADJOINT)
    unpack = PairGradient.unpack
    memory = store_pixels([pixel.fields() for pixel in tile], WIDTH)
    given = store_pixels([[end, *g] for end, g in zip(ends, by_y, strict=True)], WIDTH)

    def body(k: Array, memory: Memory, given: Memory, *ahead: Array) -> tuple:
        gaussians, ahead = iterator.next(k, ahead)
        here, real = zip(*(back(k, turn) for turn in range(UNROLL_ADJOINT)), strict=True)

        def step(j: Array, pixels: Rows, given: Rows, sums: Rows) -> tuple[Rows, Rows]:
            row_of_pixels, out = [PixelAdjoint(*fields) for fields in pixels], []
            for turn, g in enumerate(gaussians):
                row, v = PixelRow.of(g, window.x, window.y, j), [None] * WIDTH
                total = PairGradientSums(unpack(sums[turn], slot_format), slot_format)
                for i in MIRRORED:
                    end, *by_y = given[i]
                    alpha = Alpha.at(row, PLACES[i], options, here[turn] < end)
                    row_of_pixels[i], v[i], weight = row_of_pixels[i].step_back(
                        alpha, g.features, by_y, options
                    )
                    total.add_pixel(g, alpha, v[i], weight, by_y)
                if slot_format.moments:
                    total.add_row(row, v)
                out.append(total.slot().pack())
            return [pixel.fields() for pixel in row_of_pixels], out

        zeros = [[window.x * 0] * PairGradient.columns(slot_format)] * UNROLL_ADJOINT
        memory, given, sums = for_each_row(step, memory, given, zeros, F)
        for turn, columns in enumerate(sums):
            packets.store(slots, unpack(columns, slot_format), here[turn], real[turn])
        k = dr.select(k > UNROLL_ADJOINT, k - UNROLL_ADJOINT, 0)
        return (k, memory, given, *ahead)

    last, start = U(lists.end), lists.start
    state = (last, memory, given, *iterator.begin(last))
    dr.while_loop(state, lambda k, *_: k > start, body, mode="symbolic", compress=False)
    dr.eval(slots, grad_background)
    return slots, grad_background


@Frozen
def blend_tangent(
    splats: packets.Packets,
    dsplats: packets.Packets,
    lists: Lists,
    stop: Array,
    saved_pixels: SavedPixels,
    grid: Grid,
    background: list[Array],
    dbackground: list[Array],
    *,
    pixels: int,
    format: RecordFormat,
    options: SplatOptions,
) -> Planes:
    """Eq. 17, one lane per tile.

    Args:
        splats, lists, grid, background, format, options: as :func:`blend` took them.
        saved_pixels, stop: as :func:`blend` returned them.
        dsplats, dbackground: tangents.
        pixels: to allocate.
    """
    F = type(splats[0])
    window = Window.of(lists, grid, F)
    zero, n = window.x * 0, format.channels + format.depth
    tile = [PixelTangent(zero + 1, zero, [zero] * n) for _ in range(PIXELS)]
    ends = window.load(saved_pixels.end)

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        tile = PixelTangent.of_state(state)
        g, d = (load_splat(rows, format, lists.ids, k, k < lists.end) for rows in (splats, dsplats))
        rows = [PixelRow.of(g, window.x, window.y, j) for j in range(HEIGHT)]
        for i, pixel in enumerate(tile):
            j, column = divmod(i, WIDTH)
            alpha = Alpha.at(rows[j], PLACES[column], options)
            dx, dy = window.x - g.u.x + (column + 0.5), window.y - g.u.y + (j + 0.5)
            dalpha = alpha.tangent(d.lo, w_tangent(g, d, dx, dy), options)
            tile[i] = pixel.step_tangent(alpha.value, dalpha, g.features, d.features, k < ends[i])
        return (k + 1, *PixelTangent.state(tile))

    state = (type(lists.start)(lists.start), *PixelTangent.state(tile))
    state = dr.while_loop(state, lambda k, *_: k < stop, body, mode="symbolic", compress=False)
    tile = PixelTangent.of_state(state[1:])
    window = Window.of(lists, grid, F)  # again, as in blend
    dcolor = [
        [
            pixel.dy[c] + pixel.dT * background[c] + dr.abs(pixel.T) * dbackground[c]
            for c in range(len(background))
        ]
        for pixel in tile
    ]
    dplanes = Planes.empty(F, format, pixels)
    window.store_channels(dplanes.color, dcolor)
    window.store(dplanes.alpha, [-pixel.dT for pixel in tile])
    if format.depth:
        window.store(dplanes.depth, [pixel.dy[-1] for pixel in tile])
    dr.eval(dplanes)
    return dplanes


def _gradient_of_sums(
    window: Window, grad: Planes, background: list[Array], saved_pixels: SavedPixels, moments: bool
) -> tuple[list[list[Array]], list[PixelAdjoint]]:
    """Return g of each pixel, and the pixels' state behind the last Gaussian (eq. 15)."""
    by_color = window.load_channels(grad.color, len(background))
    by_alpha = [None] * PIXELS if grad.alpha is None else window.load(grad.alpha)
    by_depth = [] if grad.depth is None else window.load(grad.depth)
    tile = []
    for T, g, h in zip(window.load(saved_pixels.T), by_color, by_alpha, strict=True):
        behind = None if h is None else -h
        for c, color in enumerate(background):
            behind = color * g[c] if behind is None else dr.fma(color, g[c], behind)
        tile.append(PixelAdjoint(T, behind if moments else None))
    return [g + by_depth[i : i + 1] for i, g in enumerate(by_color)], tile


class PairGradientSums:
    """Accumulates eq. 16 of one pair over the tile's pixels, from sums so far."""

    def __init__(self, sums: PairGradient, format: RecordFormat) -> None:
        self.m0, self.m1, self.m2, self.absolute = sums.m0, sums.m1, sums.m2, sums.absolute
        self.grad_f = [*sums.color, *([sums.depth] if format.depth else [])]
        self.format = format

    def add_pixel(self, g: Splat, alpha: Alpha, v: Array, weight: Array, by_y: list[Array]) -> None:
        """Add one pixel's share of grad_f and of the absolute sums."""
        channels, depth = self.format.channels, self.format.depth
        for c, by_feature in enumerate([*by_y[:channels], *by_y[len(by_y) - depth :]]):
            self.grad_f[c] = dr.fma(weight, by_feature, self.grad_f[c])
        if self.absolute is not None:
            by_u_y = g.q * alpha.wx + g.r * alpha.wy
            self.absolute = self.absolute + Vec2(dr.abs(v * alpha.wx), dr.abs(v * by_u_y))

    def add_row(self, row: PixelRow, v: list[Array]) -> None:
        """Add the moments of a row of pixels, from s_n = sum v e^n about the row's middle.

        Pixels at e and -e share a product.
        """
        s0 = s1 = s2 = None
        for left in range(WIDTH // 2):
            e = -PLACES[left]
            both, difference = v[left] + v[WIDTH - 1 - left], v[WIDTH - 1 - left] - v[left]
            s0, s1, s2 = plus(s0, both), _fma(difference, e, s1), _fma(both, e * e, s2)
        ps1 = row.p * s1
        sx, sy = dr.fma(row.middle, s0, ps1), s0 * row.wy  # sums of v w_x and v w_y
        self.m0 = self.m0 + s0
        self.m1 = self.m1 + Vec2(sx, sy)
        self.m2 = Sym2(
            self.m2.xx + dr.fma(row.middle, sx + ps1, row.p * row.p * s2),
            dr.fma(sx, row.wy, self.m2.xy),
            dr.fma(sy, row.wy, self.m2.yy),
        )

    def slot(self) -> PairGradient:
        """Return the sums as a record."""
        color = self.grad_f[: self.format.channels]
        depth = self.grad_f[-1] if self.format.depth else None
        return PairGradient(self.m0, self.m1, self.m2, self.absolute, color, depth)


def _clear_unseen(slots: packets.Packets, lists: Lists, format: RecordFormat) -> None:
    """Write zeros to the slots of pairs behind the place where their tile's pixels stopped."""
    F, U = type(slots[0]), type(lists.end)
    zero = F(lists.real) * 0
    nothing = PairGradient.unpack([zero] * PairGradient.columns(format), format)

    def body(k: Array) -> tuple[Array]:
        packets.store(slots, nothing, k)
        return (k + 1,)

    behind = (U(lists.end),)
    dr.while_loop(behind, lambda k: k < lists.whole, body, mode="symbolic", compress=False)


def sum_slots(
    lists: Lists, places: Array, slots: packets.Packets, format: RecordFormat, sums: packets.Packets
) -> None:
    """Add up each Gaussian's slots, one after the other, and store them in its row of ``sums``.

    Lanes are Gaussians in the order of emission, so that a packet reads ``lists.places`` in order.
    """
    zero = dr.zeros(type(slots[0]), dr.width(lists.order))

    def body(k: Array, *total: Array) -> tuple[Array, ...]:
        pair = dr.gather(type(k), places, k)
        slot = packets.load(slots, PairGradient, format, pair).pack()
        return (k + 1, *(a + b for a, b in zip(total, slot, strict=True)))

    last = lists.first + lists.counts
    zeros = (zero * 1 for _ in range(PairGradient.columns(format)))
    state = (type(lists.first)(lists.first), *zeros)
    state = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic", compress=False)
    packets.store(sums, PairGradient.unpack(state[1:], format), lists.order)


def _fma(a: Array, b: Array, c: Array | None) -> Array:
    return a * b if c is None else dr.fma(a, b, c)
