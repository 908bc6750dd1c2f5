"""Several crops of one view rendered together, each at a resolution of its own.

A crop of a picture is seen from the same place, so its rays, contours and samples are those of the
picture, on another grid of pixels. A view of several crops shoots the rays of all its tiles
together and samples every edge once. With the scale ``r`` of a tile, its pixels per pixel of the
view:

1. ray       pixel ``(i, j)`` of the tile lies at ``corner + (i + 1/2, j + 1/2) / r`` in the view,
2. edges     a point of an edge carries ``r²`` times as much to each tile that holds it as to the
   view, since areas are counted in the tile's pixels there,
3. interior  where ``1 / A`` points on triangles lie in a pixel of the view, a point and a ray count
   by ``r² / (r² + 1 / A)`` in the tile, one over their density there (``interior.py``, eq. 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
from gva_mi_plugins.mesh_normals.pixel_filter import PixelFilter, column_and_row


@dataclass(frozen=True)
class Tile:
    """A part of a view on a grid of its own."""

    left: float  # of its corner, pixels of the view
    top: float
    scale: float  # its pixels for one of the view
    width: int  # its pixels
    height: int


@dataclass(frozen=True)
class _Grid:
    """A tile in Dr.Jit arrays: its numbers change between views and are no kernel constants."""

    corner: mi.Point2f  # pixels of the view
    scale: mi.Float
    size: mi.Point2f  # its pixels
    columns: mi.UInt32
    start: mi.UInt32  # of its pixels among those of all tiles


@dataclass(frozen=True)
class MultiCrop(PixelFilter):
    """The pixels of all tiles, one tile after the other, as an image of one row."""

    grids: tuple[_Grid, ...]

    @staticmethod
    def of(tiles: Sequence[Tile], film: mi.Film) -> MultiCrop:
        """Make the crops of a film with a box filter; the film itself is not sampled.

        Raises:
            ValueError: another filter.
        """
        if not film.rfilter().is_box_filter():
            raise ValueError("mesh_normals: a view in tiles needs a film with the filter 'box'")
        grids, start, one = [], 0, mi.Float(1)
        for tile in tiles:
            corner, size = mi.Point2f(tile.left, tile.top), mi.Point2f(tile.width, tile.height)
            grid = _Grid(
                corner, mi.Float(tile.scale), size, mi.UInt32(tile.width), mi.UInt32(start)
            )
            dr.make_opaque(grid.corner, grid.scale, grid.size, grid.columns, grid.start)
            grids.append(grid)
            start += tile.width * tile.height
        return MultiCrop(start, 1, 1, 0, film.rfilter(), one, one, one, tuple(grids))

    def positions(self, rays: mi.UInt32 | None = None) -> mi.Point2f:
        """Return the positions of the pixels' rays in the view (eq. 1)."""
        if rays is None:
            rays = dr.arange(mi.UInt32, self.width)
        corner, scale, columns, start = mi.Point2f(0), mi.Float(1), mi.UInt32(1), mi.UInt32(0)
        for grid in self.grids:
            here = rays >= grid.start
            corner = dr.select(here, grid.corner, corner)
            scale = dr.select(here, grid.scale, scale)
            columns = dr.select(here, grid.columns, columns)
            start = dr.select(here, grid.start, start)
        x, y = column_and_row(rays - start, columns)
        return corner + mi.Point2f(x + 0.5, y + 0.5) / scale

    def balance(self, crowd: mi.Float, rays: mi.UInt32) -> mi.Float:
        """Eq. 3 of the rays; 1 of the points, whose weights depend on the tile."""
        sample = dr.arange(mi.UInt32, dr.width(crowd))
        of_image = sample < dr.opaque(mi.UInt32, dr.width(rays))
        ray = dr.gather(mi.UInt32, rays, sample, of_image)
        scale = mi.Float(1)
        for grid in self.grids:
            scale = dr.select(ray >= grid.start, grid.scale, scale)
        return dr.select(of_image, _share(scale, crowd), 1)

    def _around(
        self, q: mi.Point2f, crowd: mi.Float | None
    ) -> Iterator[tuple[mi.UInt32, mi.Float, mi.Bool]]:
        """The pixel of each tile that holds a point of the view, and its weight (eq. 2, 3)."""
        for grid in self.grids:
            at = (q - grid.corner) * grid.scale
            valid = (at.x >= 0) & (at.y >= 0) & (at.x < grid.size.x) & (at.y < grid.size.y)
            x, y = (dr.select(valid, mi.UInt32(mi.Int32(p)), 0) for p in (at.x, at.y))
            weight = dr.square(grid.scale) if crowd is None else _share(grid.scale, crowd)
            yield grid.start + y * grid.columns + x, weight, valid


def _share(scale: mi.Float, crowd: mi.Float) -> mi.Float:
    """Eq. 3, with as many points for a pixel of the view as ``crowd`` says."""
    return dr.square(scale) * dr.rcp(dr.square(scale) + crowd)
