"""Front-to-back compositing of the tiles' lists: the loops around the steps of pixel.py.

One SIMD lane is one tile and walks its own list: forward front to back, in the adjoint back to
front from where its pixels stopped. Every pair writes a *slot* of its own, and ``sum_slots`` adds a
Gaussian's slots in a fixed order: no atomics, the same bits at every run and for any number of
threads.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets
from gva_mi.splat.kernels.frozen import Frozen
from gva_mi.splat.kernels.pixel import (
    MIRRORED,
    PIXELS,
    PLACES,
    Alpha,
    Pixel,
    PixelAdjoint,
    PixelRow,
    PixelTangent,
    SlotSums,
    larger,
    w_tangent,
)
from gva_mi.splat.kernels.planes import Planes, Trail, Window
from gva_mi.splat.kernels.records import Format, Slot, Splat
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists
from gva_mi.splat.options import SplatOptions

# Gaussians per turn of the loops: each turn loads and stores what its tile's pixels hold, for they
# do not fit into the registers
UNROLL, UNROLL_ADJOINT = 4, 2
UNSEEN = -1e30  # lo of a Gaussian that no pixel sees


@dataclass(frozen=True)
class Limit:
    """How far each pixel sees, for pictures with an opaque surface in them."""

    plane: Array  # m, one number per pixel of the padded picture
    depths: Array  # (N,) m, of the Gaussians


@dataclass(frozen=True)
class Walk:
    """A lane's way through its tile's list, which reads ahead.

    Where a Gaussian lies in memory is known once its id is read, and both take their time. So a
    turn of the loop reads the rows that the next turn needs, and the ids of the turn after that:
    the loop's variables hold them in between.
    """

    splats: packets.Packets
    format: Format
    ids: Array
    # The j-th pair that is met from the loop's k, and whether the tile's list has it.
    place: Callable[[Array, int], tuple[Array, Array]]
    turn: int  # Gaussians that a turn meets

    def begin(self, k: Array) -> list[Array]:
        """What is ahead of the first turn, at ``k``."""
        ids = [self._id(k, j) for j in range(2 * self.turn)]
        return [*ids[self.turn :], *self._rows(ids[: self.turn], k, 0)]

    def meet(self, k: Array, ahead: Sequence[Array]) -> tuple[list[Splat], list[Array]]:
        """The Gaussians of the turn at ``k``, and what is ahead of the next one."""
        ids, rows = list(ahead[: self.turn]), ahead[self.turn :]
        columns = len(rows) // self.turn
        here = [
            Splat.unpack(rows[j * columns : (j + 1) * columns], self.format)
            for j in range(self.turn)
        ]
        after = [self._id(k, 2 * self.turn + j) for j in range(self.turn)]
        return here, [*after, *self._rows(ids, k, self.turn)]

    @property
    def length(self) -> int:
        """How many of the loop's variables are ahead."""
        return self.turn * (1 + Splat.columns(self.format))

    def _id(self, k: Array, j: int) -> Array:
        pair, inside = self.place(k, j)
        return dr.gather(type(self.ids), self.ids, pair, active=inside)

    def _rows(self, ids: list[Array], k: Array, first: int) -> list[Array]:
        """The columns of the Gaussians ``ids``, the first of which is the ``first`` from k on."""
        rows = []
        for j, gaussian in enumerate(ids):
            _, inside = self.place(k, first + j)
            rows += _row(self.splats, self.format, gaussian, inside).pack()
        return rows


@Frozen
def blend(
    splats: packets.Packets,
    lists: Lists,
    grid: Grid,
    background: list[Array],
    limit: Limit | None,
    *,
    pixels: int,
    format: Format,
    options: SplatOptions,
) -> tuple[Planes, Trail, Array]:
    """Eq. 11-14, lane per tile.

    Args:
        splats: the Gaussians in the picture.
        lists: the tiles' lists.
        grid: the picture.
        background: one array of size one per colour channel.
        limit: None where pixels see all Gaussians.
        pixels: to make room for: at least those of the picture, padded to whole tiles.
        format: of the splats; with a depth, its picture is made too.
        options: cut-offs.

    Returns:
        The picture, the trail, and where in ``ids`` each lane stopped.
    """
    F, U = type(splats[0]), type(lists.tile)
    window = Window.of(lists, grid, F)
    nothing = [window.x * 0 for _ in range(format.channels + format.depth)]
    # pixels outside the picture have stopped before they start
    T = [dr.select(inside, F(1), F(-1)) for inside in window.inside(grid, F)]
    tile = [Pixel(first, U(0), nothing) for first in T]
    limits = [] if limit is None else window.load(limit.plane)

    walk = Walk(splats, format, lists.ids, lambda k, j: (k + j, k + j < lists.end), UNROLL)

    def body(k: Array, alive: Array, *state: Array) -> tuple[Array, ...]:
        gaussians, ahead = walk.meet(k, state[: walk.length])
        tile = Pixel.of_state(state[walk.length :])
        for turn, g in enumerate(gaussians):
            z = None if limit is None else _depth(limit, lists, k + turn)
            rows = [PixelRow.of(g, window.x, window.y, j) for j in range(HEIGHT)]
            for i, pixel in enumerate(tile):
                alpha = Alpha.at(rows[i // WIDTH], PLACES[i % WIDTH], options).value
                within = None if limit is None else z < limits[i]
                tile[i] = pixel.step(alpha, g.features, k + (turn + 1), within, options)
        greatest = functools.reduce(larger, [pixel.T for pixel in tile])
        return (k + UNROLL, greatest > 0, *ahead, *Pixel.state(tile))

    alive, start = lists.start < lists.end, U(lists.start)
    state = (start, alive, *walk.begin(start), *Pixel.state(tile))
    _, _, *state = dr.while_loop(
        state, lambda k, alive, *_: (k < lists.end) & alive, body, mode="symbolic", compress=False
    )
    tile = Pixel.of_state(state[walk.length :])
    window = Window.of(lists, grid, F)  # anew: its rows would hold registers through the loop
    planes = Planes.empty(F, format, pixels, dr.empty)
    trail = Trail(dr.empty(F, pixels), dr.empty(U, pixels))
    last = [dr.abs(pixel.T) for pixel in tile]
    color = [
        [dr.fma(T, behind, pixel.y[c]) for c, behind in enumerate(background)]
        for T, pixel in zip(last, tile, strict=True)
    ]
    window.store_channels(planes.color, color)
    window.store(planes.alpha, [1 - T for T in last])
    if format.depth:
        window.store(planes.depth, [pixel.y[-1] for pixel in tile])
    window.store(trail.T, last)
    window.store(trail.end, [pixel.end for pixel in tile])
    ends = functools.reduce(larger, [pixel.end for pixel in tile])
    stop = dr.clip(ends, lists.start, lists.end)
    dr.eval(planes, trail, stop)
    return planes, trail, stop


@Frozen
def blend_adjoint(
    splats: packets.Packets,
    lists: Lists,
    stop: Array,
    grid: Grid,
    background: list[Array],
    trail: Trail,
    grad: Planes,
    *,
    pairs: int,
    lanes: int,
    format: Format,
    slot_format: Format,
    options: SplatOptions,
) -> tuple[packets.Packets, Array]:
    """Eq. 15-16, lane per tile: one slot per pair, and each lane's share of grad_background.

    Args:
        splats, lists, grid, background, format, options, trail, stop: as :func:`blend` took and
            returned them.
        grad: dL/dy; its alpha and depth may be None.
        pairs, lanes: widths of ``lists.ids`` and ``lists.tile``.
        slot_format: of the slots; without a depth where no loss looks at it, and without moments or
            channels where nobody asks for the gradients made of them.

    Returns:
        The pairs' slots, and D floats per lane.
    """
    F, U = type(splats[0]), type(lists.tile)
    window = Window.of(lists, grid, F)
    by_y, tile = _gradient_of_sums(window, grad, background, trail, slot_format.moments)
    ends = window.load(trail.end)
    grad_background = dr.empty(F, lanes * len(background))
    share = [
        sum(pixel.T * g[c] for pixel, g in zip(tile, by_y, strict=True))
        for c in range(len(background))
    ]
    share = [dr.select(lists.real, s, 0) for s in share]
    packets.store_rows(grad_background, share, dr.arange(U, dr.width(lists.tile)))
    columns = Slot.columns(slot_format)
    slots = [dr.zeros(F, pairs * width) for width in packets.widths(columns)]

    back = lambda k, j: (k - (j + 1), k > lists.start + j)
    walk = Walk(splats, format, lists.ids, back, UNROLL_ADJOINT)

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        gaussians, ahead = walk.meet(k, state[: walk.length])
        tile = PixelAdjoint.of_state(state[walk.length :])
        for turn, g in enumerate(gaussians):
            (here, real), sums = back(k, turn), SlotSums(slot_format)
            for j in range(HEIGHT):
                row, v = PixelRow.of(g, window.x, window.y, j), [None] * WIDTH
                for column in MIRRORED:
                    i = j * WIDTH + column
                    alpha = Alpha.at(row, PLACES[column], options, here < ends[i])
                    tile[i], v[column], weight = tile[i].step_back(
                        alpha, g.features, by_y[i], options
                    )
                    sums.add_pixel(g, alpha, v[column], weight, by_y[i])
                if slot_format.moments:
                    sums.add_row(row, v)
            packets.store(slots, sums.slot(), here, real)
        k = dr.select(k > UNROLL_ADJOINT, k - UNROLL_ADJOINT, 0)
        return (k, *ahead, *PixelAdjoint.state(tile))

    last, start = U(stop), lists.start
    state = (last, *walk.begin(last), *PixelAdjoint.state(tile))
    dr.while_loop(state, lambda k, *_: k > start, body, mode="symbolic", compress=False)
    dr.eval(slots, grad_background)
    return slots, grad_background


@Frozen
def blend_tangent(
    splats: packets.Packets,
    dsplats: packets.Packets,
    lists: Lists,
    stop: Array,
    trail: Trail,
    grid: Grid,
    background: list[Array],
    dbackground: list[Array],
    dplanes: Planes,
    *,
    format: Format,
    options: SplatOptions,
) -> Planes:
    """Eq. 17, lane per tile.

    Args:
        splats, lists, grid, background, format, options, trail, stop: as :func:`blend` took and
            returned them.
        dsplats, dbackground: tangents.
        dplanes: memory for the picture's tangent.
    """
    F = type(splats[0])
    window = Window.of(lists, grid, F)
    zero, n = window.x * 0, format.channels + format.depth
    tile = [PixelTangent(zero + 1, zero, [zero] * n) for _ in range(PIXELS)]
    ends = window.load(trail.end)

    def body(k: Array, *state: Array) -> tuple[Array, ...]:
        tile = PixelTangent.of_state(state)
        g, d = (_load(rows, format, lists.ids, k, k < lists.end) for rows in (splats, dsplats))
        rows = [PixelRow.of(g, window.x, window.y, j) for j in range(HEIGHT)]
        for i, pixel in enumerate(tile):
            j, column = divmod(i, WIDTH)
            alpha = Alpha.at(rows[j], PLACES[column], options)
            dx, dy = window.x - g.u[0] + (column + 0.5), window.y - g.u[1] + (j + 0.5)
            dalpha = alpha.tangent(d.lo, w_tangent(g, d, dx, dy), options)
            tile[i] = pixel.step_tangent(alpha.value, dalpha, g.features, d.features, k < ends[i])
        return (k + 1, *PixelTangent.state(tile))

    state = (type(lists.start)(lists.start), *PixelTangent.state(tile))
    state = dr.while_loop(state, lambda k, *_: k < stop, body, mode="symbolic", compress=False)
    tile = PixelTangent.of_state(state[1:])
    window = Window.of(lists, grid, F)  # anew, as in blend
    dcolor = [
        [
            pixel.dy[c] + pixel.dT * background[c] + dr.abs(pixel.T) * dbackground[c]
            for c in range(len(background))
        ]
        for pixel in tile
    ]
    window.store_channels(dplanes.color, dcolor)
    window.store(dplanes.alpha, [-pixel.dT for pixel in tile])
    if format.depth:
        window.store(dplanes.depth, [pixel.dy[-1] for pixel in tile])
    dr.eval(dplanes)
    return dplanes


def sum_slots(lists: Lists, slots: packets.Packets, format: Format) -> Slot:
    """Each Gaussian's slots added up, one after the other."""
    columns = Slot.columns(format)
    zero = dr.zeros(type(slots[0]), dr.width(lists.counts))

    def body(k: Array, *sums: Array) -> tuple[Array, ...]:
        pair = dr.gather(type(k), lists.slots, k)
        slot = packets.load(slots, Slot, format, pair).pack()
        return (k + 1, *(a + b for a, b in zip(sums, slot, strict=True)))

    last = lists.first + lists.counts
    state = (type(lists.first)(lists.first), *(zero * 1 for _ in range(columns)))
    state = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic", compress=False)
    return Slot.unpack(state[1:], format)


def _load(splats: packets.Packets, format: Format, ids: Array, k: Array, inside: Array) -> Splat:
    """The Gaussian of pair ``k``; where not ``inside`` the tile's list, one that no pixel sees."""
    return _row(splats, format, dr.gather(type(ids), ids, k, active=inside), inside)


def _row(splats: packets.Packets, format: Format, gaussian: Array, inside: Array) -> Splat:
    """One Gaussian; where not ``inside`` a list, one that no pixel sees."""
    g = packets.load(splats, Splat, format, gaussian)
    return replace(g, lo=dr.select(inside, g.lo, UNSEEN))


def _depth(limit: Limit, lists: Lists, k: Array) -> Array:
    """The depth of the Gaussian of pair ``k``."""
    gaussian = dr.gather(type(k), lists.ids, k, active=k < lists.end)
    return dr.gather(type(limit.depths), limit.depths, gaussian)


def _gradient_of_sums(
    window: Window, grad: Planes, background: list[Array], trail: Trail, moments: bool
) -> tuple[list[list[Array]], list[PixelAdjoint]]:
    """g of each pixel, and the pixels as they stand behind the last Gaussian (eq. 15)."""
    by_color = window.load_channels(grad.color, len(background))
    by_alpha = [None] * PIXELS if grad.alpha is None else window.load(grad.alpha)
    by_depth = [] if grad.depth is None else window.load(grad.depth)
    tile = []
    for T, g, h in zip(window.load(trail.T), by_color, by_alpha, strict=True):
        behind = None if h is None else -h
        for c, color in enumerate(background):
            behind = color * g[c] if behind is None else dr.fma(color, g[c], behind)
        tile.append(PixelAdjoint(T, behind if moments else None))
    return [g + by_depth[i : i + 1] for i, g in enumerate(by_color)], tile
