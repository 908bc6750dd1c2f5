"""Lists of the Gaussians that touch each tile, front to back: integers, without gradients.

A tile is ``WIDTH x HEIGHT`` pixels, the work of one SIMD lane. The steps:

1. count exactly the tiles that each Gaussian's ellipse alpha >= alpha_min (ellipse.py, eq. 7)
   touches, one row of tiles after the other;
2. sort the Gaussians by depth, stably, and sum up the counts: where the pairs of each start;
3. emit one (tile, Gaussian) pair per touched tile, in depth order;
4. sort the pairs by tile, stably, so that every tile's list is in depth order;
5. assign the lists to SIMD lanes and threads.

A packet works until its longest list ends. Therefore lists of similar length share a packet.
Packets are dealt round-robin over the blocks that threads work on, or one thread would get all long
lists. The result of a list does not depend on its lane.

The number of pairs M differs from pose to pose. Pair buffers therefore have a *capacity*: M rounded
up to one of four sizes per octave. So memory stays as large as the largest picture needed, without
fragmentation. The padding belongs to the last tile, and the stable sort leaves it at the end.
Pixels and lanes have a capacity too, because every box cut out of a video has another size: few
sizes need few recordings of the kernels (frozen.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.jit.frozen import Frozen
from gva_mi.splat.kernels.records import Footprint

WIDTH, HEIGHT = 8, 4  # pixels of a tile: chosen, a row is one packet of 8 floats
# Mean pairs per lane from which on the adjoint's lists are scheduled again. Chosen: it takes time,
# and pixels stop early in long lists only.
RESCHEDULED_PAIRS = 32
MAX_PAIRS = 2**29 - 1  # slots are packets of 8 floats, counted by 32-bit indices
ELLIPSE_SLACK = 1e-3  # px, widens an ellipse: chosen, twice float32's rounding at 8,192 px

NoConflicts = dr.ReduceMode.NoConflicts


@dataclass(frozen=True)
class Grid:
    """The picture in tiles, as arrays for the kernels: another size needs no other kernel."""

    width: Array  # px
    height: Array  # px
    columns: Array  # tiles side by side


@dataclass(frozen=True)
class Layout:
    """The picture in tiles, as numbers on the host."""

    width: int  # px
    height: int  # px

    @property
    def columns(self) -> int:
        """Number of tiles side by side."""
        return -(-self.width // WIDTH)

    @property
    def rows(self) -> int:
        """Number of tiles on top of each other."""
        return -(-self.height // HEIGHT)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return self.columns * self.rows

    @property
    def padded(self) -> tuple[int, int]:
        """Height and width in whole tiles, px."""
        return self.rows * HEIGHT, self.columns * WIDTH

    @property
    def pixels(self) -> int:
        """Number of pixels, padding included."""
        return self.tiles * WIDTH * HEIGHT

    def grid(self, I: type) -> Grid:
        """Return the arrays for the kernels, in signed integers of type ``I``."""
        return Grid(*(dr.opaque(I, n) for n in (self.width, self.height, self.columns)))


@dataclass(frozen=True)
class Lists:
    """Every tile's Gaussians, front to back."""

    ids: Array  # (capacity,) Gaussian of each pair, sorted by tile, then depth
    emitted: Array  # (capacity,) place of each of these pairs in the order of emission
    order: Array  # (N,) Gaussians in the order of emission, front to back
    first: Array  # (N,) the first pair of each of these in that order
    counts: Array  # (N,) tiles each of these touches
    tile: Array  # (lanes,) tile of each lane of the compositing kernel
    start: Array  # (lanes,) its list in ids: first
    end: Array  # (lanes,) and one past the last, or the last that was composited
    whole: Array  # (lanes,) and one past the last
    real: Array  # (lanes,) False for lanes that only fill up packets: an empty list, tile 0

    def places(self) -> Array:
        """Return the index in ``ids`` of each pair in the order of emission, (capacity,)."""
        U, pairs = type(self.ids), dr.width(self.ids)
        places = packets.memory(U, pairs)
        dr.scatter(places, dr.arange(U, pairs), self.emitted, mode=dr.ReduceMode.Permute)
        dr.eval(places)
        return places


def capacity(count: int) -> int:
    """Round ``count`` up to 4, 5, 6 or 7 times a power of two."""
    step = 1 << max(0, count.bit_length() - 3)
    return -(-count // step) * step


def _rows_touched(g: Footprint, grid: Grid) -> tuple[Array, Array]:
    """Return the rows of tiles [first, last) that an ellipse may reach."""
    F, I = type(g.u), type(grid.height)
    low = dr.maximum(dr.ceil(g.v - g.ry - 0.5 - ELLIPSE_SLACK), 0)
    high = dr.minimum(dr.floor(g.v + g.ry - 0.5 + ELLIPSE_SLACK), F(grid.height) - 1)
    ok = (g.ry >= 0) & (low <= high)
    ok &= (g.u + g.rx + ELLIPSE_SLACK >= 0.5) & (g.u - g.rx - ELLIPSE_SLACK <= F(grid.width) - 0.5)
    first = I(dr.select(ok, low, 0)) // HEIGHT
    return first, dr.select(ok, I(dr.select(ok, high, 0)) // HEIGHT + 1, first)


def _columns_touched(g: Footprint, row: Array, grid: Grid) -> tuple[Array, Array]:
    """Return the tiles [left, right) of a row of tiles with pixel centres in the ellipse."""
    F, I = type(g.u), type(row)
    y = F(row * HEIGHT) + 0.5
    top, bottom = dr.maximum(y - g.v, -g.ry), dr.minimum(y + (HEIGHT - 1) - g.v, g.ry)
    ok = top <= bottom
    right, left = (dr.minimum(dr.maximum(d, top), bottom) for d in (g.turn, -g.turn))
    # ry = 0 only where the ellipse is a point
    chord = lambda d: g.half * dr.sqrt(dr.maximum(1 - dr.square(d / dr.maximum(g.ry, 1e-6)), 0))
    low = dr.maximum(dr.ceil(g.u + g.shear * left - chord(left) - 0.5 - ELLIPSE_SLACK), 0)
    high = g.u + g.shear * right + chord(right) - 0.5 + ELLIPSE_SLACK
    high = dr.minimum(dr.floor(high), F(grid.width) - 1)
    ok &= low <= high
    begin = I(dr.select(ok, low, 0)) // WIDTH
    return begin, dr.select(ok, I(dr.select(ok, high, 0)) // WIDTH + 1, begin)


def boxed(g: Footprint, grid: Grid) -> Array:
    """Whether the box of whole pixels around an ellipse overlaps the picture, (N,)."""
    F = type(g.u)
    rx, ry = dr.ceil(g.rx), dr.ceil(g.ry)
    beside = (rx > 0) & (g.u + rx > 0) & (g.u - rx < F(grid.width))
    return beside & (ry > 0) & (g.v + ry > 0) & (g.v - ry < F(grid.height))


def count(g: Footprint, grid: Grid) -> Array:
    """Step 1: count the tiles that each Gaussian touches, (N,)."""
    U = dr.uint32_array_t(type(g.u))
    first, last = _rows_touched(g, grid)

    def body(row: Array, n: Array) -> tuple[Array, Array]:
        begin, end = _columns_touched(g, row, grid)
        return row + 1, n + U(end - begin)

    return dr.while_loop((first, U(first) * 0), lambda row, n: row < last, body, mode="symbolic")[1]


@Frozen
def _emit(
    footprints: packets.Packets, order: Array, start: Array, grid: Grid, last: Array, *, size: int
) -> tuple[Array, Array]:
    """Step 3: one lane per Gaussian, front to back; one pair per turn of the inner loop.

    The result is ``size`` pairs, the Gaussian in the lower half and the tile in the upper half of
    one integer, and the tiles alone; the padding's tile is ``last``.
    """
    U, I, Pair = type(order), type(grid.width), dr.uint64_array_t(type(order))
    of = lambda tile, gaussian: (Pair(tile) << 32) | Pair(gaussian)
    pairs = of(last, dr.zeros(U, size))
    dr.eval(pairs)
    g = packets.load(footprints, Footprint, None, order)
    first, last = _rows_touched(g, grid)

    def body(row: Array, k: Array) -> tuple[Array, Array]:
        begin, end = _columns_touched(g, row, grid)
        before = row * grid.columns

        def write(column: Array, k: Array) -> tuple[Array, Array]:
            dr.scatter(pairs, of(U(before + column), order), k, mode=NoConflicts)
            return column + 1, k + 1

        within = lambda column, k: column < end
        return row + 1, dr.while_loop((I(begin), U(k)), within, write, mode="symbolic")[1]

    dr.while_loop((I(first), U(start)), lambda row, k: row < last, body, mode="symbolic")
    dr.eval(pairs)
    tile = U(pairs >> 32)
    dr.eval(tile)
    return pairs, tile


@Frozen
def _ranges(
    pairs: Array, permutation: Array, last: Array, start: Array, end: Array, *, size: int
) -> tuple[Array, ...]:
    """Step 4, after the sort: make the lists and their ranges."""
    U = type(permutation)
    k = dr.arange(U, size)
    pair = dr.gather(type(pairs), pairs, permutation)
    ids, here = U(pair), U(pair >> 32)
    dr.eval(ids, here)
    before = dr.gather(U, here, dr.select(k > 0, k - 1, 0))
    fresh = (k <= last) & (before != here)
    dr.scatter(start, k, here, active=fresh, mode=NoConflicts)  # the first list starts at 0
    dr.scatter(end, k, before, active=fresh, mode=NoConflicts)
    dr.scatter(end, k + 1, here, active=k == last, mode=NoConflicts)
    dr.eval(ids, start, end)
    return ids, start, end


def _schedule(start: Array, end: Array) -> tuple[Array, ...]:
    """Step 5: assign each lane a tile and its list."""
    U, tiles = type(start), dr.width(start)
    per_block = capacity(-(-tiles // (LANES * BLOCKS)))  # packets
    tile = lists_by_length(end - start, per_block * BLOCKS * LANES)
    real = tile < dr.opaque(U, tiles)
    tile = dr.select(real, tile, 0)
    start, end = dr.gather(U, start, tile, active=real), dr.gather(U, end, tile, active=real)
    dr.eval(tile, start, end, real)
    return tile, start, end, end, real


def composited(lists: Lists, stop: Array) -> Lists:
    """Cut each list where its lane stopped, and schedule long lists again.

    In long lists pixels stop early, each tile's elsewhere: the lanes of a packet, whose lists were
    equally long, would wait for one another.

    Args:
        lists: as compositing iterated over them.
        stop: (lanes,) as ``blend`` returned it.
    """
    lanes = dr.width(stop)
    if dr.width(lists.ids) < RESCHEDULED_PAIRS * lanes:
        return replace(lists, end=stop)
    lane = lists_by_length(stop - lists.start, lanes)
    of_lanes = lists.tile, lists.start, stop, lists.whole, lists.real
    tile, start, end, whole, real = (dr.gather(type(x), x, lane) for x in of_lanes)
    dr.eval(tile, start, end, whole, real)
    return replace(lists, tile=tile, start=start, end=end, whole=whole, real=real)


def make_lists(
    footprints: packets.Packets, depths: Array, counts: Array, layout: Layout, grid: Grid
) -> Lists | None:
    """Steps 2-5; return None if nothing is drawn.

    Raises:
        ValueError: more pairs than 32-bit indices hold.
    """
    U = dr.uint32_array_t(type(depths))
    n = dr.width(depths)
    order = dr.argsort(depths)
    sorted_counts = dr.gather(U, counts, order)
    sums = dr.cumsum(dr.uint64_array_t(U)(sorted_counts))
    start = U(sums) - sorted_counts
    dr.eval(start, sorted_counts)
    pairs = int(sums[n - 1])
    if pairs == 0:
        return None
    if pairs > MAX_PAIRS:
        raise ValueError(
            f"render(): {n} Gaussians touch {pairs} tiles together, more than the {MAX_PAIRS} that "
            f"32-bit indices hold: make the picture or the Gaussians smaller"
        )
    size, tiles = capacity(pairs), layout.tiles
    emitted, tile = _emit(footprints, order, start, grid, dr.opaque(U, tiles - 1), size=size)

    permutation = dr.detail.block_mkperm(tile, size, 1 << (tiles - 1).bit_length())
    begin, end = dr.zeros(U, tiles), dr.zeros(U, tiles)
    dr.make_opaque(begin, end)
    ids, begin, end = _ranges(emitted, permutation, dr.opaque(U, pairs - 1), begin, end, size=size)
    return Lists(ids, permutation, order, start, sorted_counts, *_schedule(begin, end))


LANES = 16  # of a packet with AVX-512; AVX2's 8 divide it
BLOCKS = 16  # parts over which packets are dealt: chosen, no fewer than a usual CPU has threads
LONGEST_SORTED = 8191  # pairs; longer lists count as equally long: chosen, 2^13 bins of the sort


def lists_by_length(length: Array, lanes: int) -> Array:
    """Return the list of each lane, given their lengths; their number for lanes without one."""
    U, lists = type(length), dr.width(length)
    bins = LONGEST_SORTED - dr.minimum(length, LONGEST_SORTED)
    order = dr.detail.block_mkperm(bins, lists, LONGEST_SORTED + 1)
    lane = dr.arange(U, lanes)
    # arrays: another size needs no other kernel
    stride, count = dr.opaque(U, lanes // (BLOCKS * LANES)), dr.opaque(U, lists)
    packet = lane // LANES
    rank = ((packet % stride) * BLOCKS + packet // stride) * LANES + lane % LANES
    return dr.select(rank < count, dr.gather(U, order, rank, active=rank < count), count)
