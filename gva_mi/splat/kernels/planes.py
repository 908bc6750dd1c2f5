"""Pictures as the kernels store them: flat arrays padded to whole tiles, one tile per SIMD lane.

A lane's 32 pixels are unrolled in the trace: a quantity per pixel is a list of 32 Dr.Jit variables,
row by row, and no operation crosses lanes. Because pictures are padded, a row of a tile is one
packet of memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.records import RecordFormat
from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Grid, Lists


@dataclass(frozen=True)
class Planes:
    """A picture, its gradient or its tangent."""

    color: Array  # (rows, columns, D), background blended in
    alpha: Array | None  # (rows, columns); None if no loss depends on it
    depth: Array | None  # (rows, columns); None if it is not made, or no loss depends on it

    @staticmethod
    def empty(F: type, format: RecordFormat, pixels: int) -> Planes:
        """Allocate a picture of so many pixels, padding included, inside a frozen kernel."""
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
