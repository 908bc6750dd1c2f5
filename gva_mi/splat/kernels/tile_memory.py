"""What a lane of compositing reads and writes: pictures, its tile's list, and its tile's pixels.

One SIMD lane is one tile. Pictures are *planes*: flat arrays padded to whole tiles, so that a row
of a tile is one packet of memory. A lane's 32 pixels are unrolled in the trace: a quantity per
pixel is a list of 32 Dr.Jit variables, row by row, and no operation crosses lanes.

On the way forward a tile's state is 32 pixels of 2 + D numbers, far more than there are registers.
As variables of the loop over a tile's list they would be unrolled: 40 KB of code, whose variables
move between registers and stack at every turn. In local memory (``dr.alloc_local``) a second loop
works on ``PART`` pixels at a time. Its code is an eighth of that, and its pixels fit into
registers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.pixel import PIXELS, PLACES, Pixel, larger
from gva_mi.splat.kernels.records import RecordFormat, Splat
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists


@dataclass(frozen=True)
class Planes:
    """A picture, its gradient or its tangent."""

    color: Array  # (rows, columns, D), background blended in
    alpha: Array | None  # (rows, columns); None if no loss depends on it
    depth: Array | None  # (rows, columns); None if it is not made, or no loss depends on it

    @staticmethod
    def empty(F: type, format: RecordFormat, pixels: int) -> Planes:
        """Allocate a picture of ``pixels`` pixels, padding included, inside a frozen kernel."""
        color, alpha = dr.empty(F, pixels * format.channels), dr.empty(F, pixels)
        return Planes(color, alpha, dr.empty(F, pixels) if format.depth else None)

    @staticmethod
    def of_background(background: list[Array], pixels: int, depth: bool) -> Planes:
        """Make the picture of no Gaussians."""
        F, D = type(background[0]), len(background)
        color = packets.memory(F, pixels * D)
        pixel = dr.arange(dr.uint32_array_t(F), pixels)
        for c in range(D):
            dr.scatter(color, background[c], pixel * D + c)
        alpha, z = dr.zeros(F, pixels), dr.zeros(F, pixels) if depth else None
        dr.eval(color, alpha, z)
        return Planes(color, alpha, z)


@dataclass(frozen=True)
class SavedPixels:
    """State that compositing saves for its adjoint: one number per pixel each."""

    T: Array  # the last transmittance of eq. 13
    end: Array  # index in ``ids`` where the pixel stopped: one past the last Gaussian that it shows


@dataclass(frozen=True)
class Limit:
    """Depth up to which each pixel shows Gaussians, where an opaque surface stands."""

    plane: Array  # m, one number per pixel of the padded picture
    depths: Array  # (N,) m, of the Gaussians

    def of_pair(self, lists: Lists, k: Array) -> Array:
        """Depth of the Gaussian of pair ``k``."""
        gaussian = dr.gather(type(k), lists.ids, k, active=k < lists.end)
        return dr.gather(type(self.depths), self.depths, gaussian)


@dataclass(frozen=True)
class Window:
    """Position of a lane's tile in the picture."""

    x: Array  # left upper corner, px
    y: Array
    rows: list[Array]  # the number of each of its rows of pixels, in rows of a tile's width
    real: Array  # False for lanes that only fill up packets and write nothing

    @staticmethod
    def of(lists: Lists, grid: Grid, F: type) -> Window:
        """Compute the window of each lane, in numbers of type ``F``."""
        columns = type(lists.tile)(grid.columns)
        row = lists.tile // columns
        column = lists.tile - row * columns
        first = row * (columns * HEIGHT) + column
        rows = [first + columns * j for j in range(HEIGHT)]
        return Window(F(column * WIDTH), F(row * HEIGHT), rows, lists.real)

    def inside(self, grid: Grid, F: type) -> list[Array]:
        """Whether each pixel of the tile lies in the picture."""
        in_x = [self.x + i < F(grid.width) for i in range(WIDTH)]
        in_y = [self.y + j < F(grid.height) for j in range(HEIGHT)]
        return [a & b for b in in_y for a in in_x]

    def load(self, plane: Array) -> list[Array]:
        """Load a number for each pixel."""
        return [number for row in self.rows for number in packets.load_rows(plane, WIDTH, row)]

    def load_channels(self, plane: Array, channels: int) -> list[list[Array]]:
        """Load the channels of each pixel."""
        out = []
        for row in self.rows:
            numbers = packets.load_rows(plane, WIDTH * channels, row)
            out += [numbers[i * channels : (i + 1) * channels] for i in range(WIDTH)]
        return out

    def store(self, plane: Array, pixels: Sequence[Array]) -> None:
        """Store a number for each pixel."""
        self.store_channels(plane, [[number] for number in pixels])

    def store_channels(self, plane: Array, pixels: Sequence[Sequence[Array]]) -> None:
        """Store the channels of each pixel."""
        for j, row in enumerate(self.rows):
            of_row = pixels[j * WIDTH : (j + 1) * WIDTH]
            numbers = [number for pixel in of_row for number in pixel]
            packets.store_rows(plane, numbers, row, self.real)


INVISIBLE_LO = -1e30  # log2 of an opacity so low that no pixel shows the Gaussian


@dataclass(frozen=True)
class TileIterator:
    """Iterates over a tile's list, and reads ahead.

    A Gaussian's address is known only after its id is read, and both reads are slow. So each turn
    of the loop reads the rows for the next turn and the ids for the turn after that; the loop's
    variables hold them in between.
    """

    splats: packets.Packets
    format: RecordFormat
    ids: Array
    # Index of the j-th pair after the loop's k, and whether the tile's list has it.
    place: Callable[[Array, int], tuple[Array, Array]]
    turn: int  # Gaussians per turn

    def begin(self, k: Array) -> list[Array]:
        """Read ahead for the first turn, at ``k``."""
        ids = [self._id(k, j) for j in range(2 * self.turn)]
        return [*ids[self.turn :], *self._rows(ids[: self.turn], k, 0)]

    def next(self, k: Array, ahead: Sequence[Array]) -> tuple[list[Splat], list[Array]]:
        """Return the Gaussians of the turn at ``k``, and what was read ahead for the next one."""
        ids, rows = list(ahead[: self.turn]), ahead[self.turn :]
        columns = len(rows) // self.turn
        row = lambda j: rows[j * columns : (j + 1) * columns]
        here = [Splat.unpack(row(j), self.format) for j in range(self.turn)]
        after = [self._id(k, 2 * self.turn + j) for j in range(self.turn)]
        return here, [*after, *self._rows(ids, k, self.turn)]

    @property
    def length(self) -> int:
        """Number of the loop's variables that hold what was read ahead."""
        return self.turn * (1 + Splat.columns(self.format))

    def _id(self, k: Array, j: int) -> Array:
        pair, inside = self.place(k, j)
        return dr.gather(type(self.ids), self.ids, pair, active=inside)

    def _rows(self, ids: list[Array], k: Array, first: int) -> list[Array]:
        """Load the columns of the Gaussians ``ids``; the first is number ``first`` after k."""
        rows = []
        for j, gaussian in enumerate(ids):
            _, inside = self.place(k, first + j)
            rows += _row(self.splats, self.format, gaussian, inside).pack()
        return rows


def load_splat(
    splats: packets.Packets, format: RecordFormat, ids: Array, k: Array, inside: Array
) -> Splat:
    """Load the Gaussian of pair ``k``; an invisible one where not ``inside`` the tile's list."""
    return _row(splats, format, dr.gather(type(ids), ids, k, active=inside), inside)


def _row(splats: packets.Packets, format: RecordFormat, gaussian: Array, inside: Array) -> Splat:
    """Load one Gaussian; an invisible one where not ``inside`` a list."""
    g = packets.load(splats, Splat, format, gaussian)
    return replace(g, lo=dr.select(inside, g.lo, INVISIBLE_LO))


PART = 4  # neighbouring pixels of a row: chosen, their state fits into the registers
PARTS = PIXELS // PART
PER_ROW = WIDTH // PART

Memory = list[dr.Local]  # a tile's numbers, ``width`` pixels at a time, field by field
Place = tuple[Array, list[Array]]  # of a part's pixels: their row in the tile, places in the row
Rows = list[list[Array]]  # fields, one list a pixel; or columns, one list a record


def store_pixels(pixels: Rows, width: int = PART) -> Memory:
    """Copy the fields of a tile's pixels to local memory, in parts of ``width`` pixels."""
    memory = []
    for place in range(width):
        for field in zip(*pixels[place::width], strict=True):
            # Without first values: LLVM clears much memory by calling a function, where vectors
            # are written by halves (Intel), and Dr.Jit's kernels cannot call one.
            local = dr.alloc_local(type(field[0]), len(field))
            for part, number in enumerate(field):
                local[part] = number
            memory.append(local)
    return memory


def load_pixels(memory: Memory, part: Array | int, width: int = PART) -> Rows:
    """Return the fields of each pixel of a part."""
    fields = len(memory) // width
    numbers = [local[part] for local in memory]
    return [numbers[i * fields : (i + 1) * fields] for i in range(width)]


def _replace_pixels(memory: Memory, part: Array, pixels: Rows) -> None:
    """Store the fields of each pixel of a part."""
    numbers = [number for fields in pixels for number in fields]
    for local, number in zip(memory, numbers, strict=True):
        local[part] = number


def for_each_part(
    step: Callable[[Place, list[Pixel], list[Array]], list[Pixel]],
    memory: Memory,
    limits: Memory,
    F: type,
) -> tuple[Memory, Memory, Array]:
    """Replace the pixels of each part by ``step(place, pixels, limits)``.

    Returns:
        ``memory``, ``limits``, and the greatest transmittance of a pixel.
    """
    U = dr.uint32_array_t(F)

    def body(part: Array, greatest: Array, memory: Memory, limits: Memory) -> tuple:
        row = part // PER_ROW
        left = F(part - row * PER_ROW) * PART
        pixels = [Pixel(T, end, y) for T, end, *y in load_pixels(memory, part)]
        within = [number for (number,) in load_pixels(limits, part)] if limits else []
        pixels = step((F(row), [left + e for e in PLACES[:PART]]), pixels, within)
        _replace_pixels(memory, part, [[p.T, p.end, *p.y] for p in pixels])
        for pixel in pixels:
            greatest = larger(greatest, pixel.T)
        return part + 1, greatest, memory, limits

    state = (U(0), F(-1), memory, limits)
    last = dr.while_loop(state, lambda part, *_: part < PARTS, body, mode="symbolic")
    return last[2], last[3], last[1]


def for_each_row(
    step: Callable[[Array, Rows, Rows, Rows], tuple[Rows, Rows]],
    memory: Memory,
    given: Memory,
    sums: Rows,
    F: type,
) -> tuple[Memory, Memory, Rows]:
    """Replace each row's pixels, and the sums, by ``step(j, pixels, given, sums)``.

    Args:
        step: of row j, with the fields of its pixels.
        memory, given: stored in parts of a row; ``given`` does not change.
        sums: columns of records before the first row.
        F: the type of the numbers.

    Returns:
        ``memory``, ``given`` and the sums after the last row.
    """
    U = dr.uint32_array_t(F)

    def body(j: Array, memory: Memory, given: Memory, sums: Rows) -> tuple:
        pixels, constants = load_pixels(memory, j, WIDTH), load_pixels(given, j, WIDTH)
        pixels, sums = step(F(j), pixels, constants, sums)
        _replace_pixels(memory, j, pixels)
        return j + 1, memory, given, sums

    state = (U(0), memory, given, sums)
    return dr.while_loop(state, lambda j, *_: j < HEIGHT, body, mode="symbolic")[1:]
