"""Reconstruction filters from samples to pixels, and their adjoint.

With a filter ``f`` of radius ``r`` and pixel centres ``c_p``, and samples ``v_i`` at ``q_i``:

1. pixel    ``I_p = Σ_i f(q_i - c_p) v_i / N_p``, ``N_p = Σ_i f(q_i - c_p)``, over the samples on
   the image: near its border there are fewer. In the limit ``N_p`` becomes ``M_p = ∫ f dA``.
2. lattice  samples lie at the same places in all pixels, so that ``f(q_i - c_p)`` depends only on
   the step ``d`` from one pixel to the other and on the place ``k``: a table ``f_{d k}``.
3. adjoint  ``∂L/∂v_i = Σ_p f(q_i - c_p) ∂L/∂I_p / N_p``.
4. a point  ``q`` of an edge adds its value times ``f(q - c_p) / M_p`` to pixel ``p``.

Pixels gather from samples, and the contributions of points are sorted by pixel
(``segment_sums.py``): the order of every sum is fixed. With the ``box`` filter each sample belongs
to one pixel, and filtering costs nothing.

:class:`MultiCrop` renders several crops of one view together, each at a resolution of its own. All
crops of a picture have one camera centre, so they share its rays, contours and samples, on another
grid of pixels. A view of several crops shoots the rays of all its tiles together and samples every
edge once. With the scale ``r`` of a tile, its pixels per pixel of the view:

5. ray       pixel ``(i, j)`` of the tile lies at ``corner + (i + 1/2, j + 1/2) / r`` in the view,
6. edges     a point of an edge adds ``r²`` times as much to each tile that holds it as to the view,
   because areas are counted in pixels of the tile,
7. interior  where ``1 / A`` points on triangles lie in a pixel of the view, a point and a ray have
   the weight ``r² / (r² + 1 / A)`` in the tile, one over their density (``interior.py``, eq. 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.segment_sums import sum_by_key

GOLDEN_STEP = 0.6180339887498949  # 1 / golden ratio: the step of a Kronecker sequence
# Points per pixel and axis of the quadrature M_p. Chosen: the filter of a film is integrated
# once, so many cost little.
POINTS_PER_PIXEL = 256


@dataclass(frozen=True)
class PixelFilter:
    """The weights between W x H pixels and ``spp`` samples in each.

    Example:
        >>> box = {"type": "hdrfilm", "width": 2, "height": 1, "rfilter": {"type": "box"}}
        >>> filter = PixelFilter.of(mi.load_dict(box), spp=2)
        >>> filter.develop([mi.Float(1, 3, 5, 5)])  # the mean of each pixel's two samples
        [[2, 5]]
    """

    width: int
    height: int
    spp: int
    steps: int  # pixels from a sample to the farthest pixel that it adds to; 0: box
    rfilter: mi.ReconstructionFilter
    table: mi.Float  # ((2 steps + 1)² spp,) eq. 2, k fastest, then d_x
    discrete: mi.Float  # (H W,) N_p
    continuous: mi.Float  # (H W,) M_p

    @staticmethod
    def of(film: mi.Film, spp: int) -> PixelFilter:
        """Make the filter of a film.

        Raises:
            ValueError: the film samples its border, and its filter is not ``box``.
        """
        width, height = (int(x) for x in film.crop_size())
        rfilter = film.rfilter()
        one = mi.Float(1)
        if rfilter.is_box_filter():
            return PixelFilter(
                width, height, spp, steps=0, rfilter=rfilter,
                table=one, discrete=one, continuous=one,
            )  # fmt: skip
        if film.sample_border():
            raise ValueError(
                "mesh_normals: the film's sample_border must be false with another filter than box"
            )
        steps = int(np.ceil(rfilter.radius() + 0.5)) - 1
        d = np.arange(-steps, steps + 1)
        x, y = lattice(spp)
        eval_ = lambda u: np.array(rfilter.eval(mi.Float(u.ravel().astype(np.float32))))
        # f(q - c_p) with q in a pixel and p the one d to its right or below.
        fx = eval_(x - 0.5 - d[:, None]).reshape(len(d), spp)
        fy = eval_(y - 0.5 - d[:, None]).reshape(len(d), spp)
        table = (fy[:, None] * fx[None]).astype(np.float32)  # (d_y, d_x, k)
        inside = (np.arange(POINTS_PER_PIXEL) + 0.5) / POINTS_PER_PIXEL
        mass = eval_(inside - 0.5 - d[:, None]).reshape(len(d), -1).mean(1)
        result = PixelFilter(
            width, height, spp, steps, rfilter, table=mi.Float(table.ravel()), discrete=one,
            continuous=mi.Float(np.outer(_total(mass, height), _total(mass, width)).ravel()),
        )  # fmt: skip
        ones = dr.ones(mi.Float, width * height * spp)
        (N,) = result._gather([ones], dr.arange(mi.UInt32, width * height))
        dr.eval(N)
        return replace(result, discrete=N)

    def positions(self, rays: mi.UInt32 | None = None) -> mi.Point2f:
        """Return the rays' pixel positions: for each pixel in turn, a lattice of ``spp`` points."""
        if rays is None:
            rays = dr.arange(mi.UInt32, self.width * self.height * self.spp)
        pixel = rays // self.spp
        k = mi.Float(rays - pixel * self.spp)
        x, y = column_and_row(pixel, self._columns)
        shift_y = 0.5 + k * GOLDEN_STEP
        return mi.Point2f(x + (k + 0.5) / self.spp, y + shift_y - dr.floor(shift_y))

    def develop(self, samples: list[mi.Float]) -> list[mi.Float]:
        """Filter samples (H W spp,), ordered by pixel, to pixels (H W,) by eq. 1."""
        if self.steps > 0:
            pixel = dr.arange(mi.UInt32, self.width * self.height)
            return [value / self.discrete for value in self._gather(samples, pixel)]
        if self.spp == 1:
            return samples
        return [dr.block_sum(x, self.spp) / self.spp for x in samples]

    def spread(self, grads: list[mi.Float], rays: mi.UInt32) -> list[mi.Float]:
        """Convert gradients of pixels (H W,) to gradients of samples (R,), eq. 3."""
        pixel = rays // self.spp
        if self.steps == 0:
            return [dr.gather(mi.Float, grad, pixel) / self.spp for grad in grads]
        grads = [grad / self.discrete for grad in grads]
        dr.eval(grads)
        return self._gather(grads, pixel, rays - pixel * self.spp)

    def balance(self, crowd: mi.Float, rays: mi.UInt32) -> mi.Float:
        """Return weights (R + S,) of rays, and of points with the density ``crowd`` per pixel.

        They are one over the common density of both sets. The weights of rays are multiplied by
        ``spp``, by which :meth:`develop` and :meth:`spread` divide.
        """
        weight = dr.rcp(self.spp + crowd)
        of_image = dr.arange(mi.UInt32, dr.width(crowd)) < dr.opaque(mi.UInt32, dr.width(rays))
        return dr.select(of_image, self.spp * weight, weight)

    def spread_to(
        self, grads: list[mi.Float], q: mi.Point2f, crowd: mi.Float | None = None
    ) -> list[mi.Float]:
        """Convert gradients of pixels (H W,) to gradients of contributions (S,) at ``q``, eq. 4.

        Points of triangles have a ``crowd``, as in :meth:`balance`.
        """
        total = [mi.Float(0)] * len(grads)
        for pixel, weight, valid in self._around(q, crowd):
            total = [
                x + weight * dr.gather(mi.Float, grad, pixel, valid)
                for x, grad in zip(total, grads, strict=True)
            ]
        return total

    def deposit(
        self,
        image: list[mi.Float],
        values: list[mi.Float],
        q: mi.Point2f,
        crowd: mi.Float | None = None,
    ) -> None:
        """Add the contributions (S,) of points at ``q`` to pixels (H W,), eq. 4."""
        for pixel, weight, valid in self._around(q, crowd):
            carried = [dr.select(valid, weight * value, 0) for value in values]
            pixel = dr.select(valid, pixel, 0)
            dr.eval(carried, pixel)
            sums, pixels = sum_by_key(carried, pixel)
            for channel, value in zip(image, sums, strict=True):
                dr.scatter_add(channel, value, pixels, mode=dr.ReduceMode.NoConflicts)
            dr.eval(image)

    def _around(
        self, q: mi.Point2f, crowd: mi.Float | None
    ) -> Iterator[tuple[mi.UInt32, mi.Float, mi.Bool]]:
        """Yield the pixels that a point on the image adds to, with ``f(q - c_p) / M_p``."""
        x, y = mi.Int32(q.x), mi.Int32(q.y)
        if self.steps == 0:
            yield mi.UInt32(y) * self._columns + mi.UInt32(x), mi.Float(1), mi.Bool(True)
            return
        reach = range(-self.steps, self.steps + 1)
        for py, px in ((y + dy, x + dx) for dy in reach for dx in reach):
            valid = (px >= 0) & (py >= 0) & (px < self.width) & (py < self.height)
            pixel = mi.UInt32(dr.select(valid, py * self.width + px, 0))
            f = self.rfilter.eval(q.x - px - 0.5) * self.rfilter.eval(q.y - py - 0.5)
            share = f / dr.gather(mi.Float, self.continuous, pixel)
            yield pixel, dr.select(valid, share, 0), valid

    def _gather(
        self, values: list[mi.Float], pixel: mi.UInt32, place: mi.UInt32 | None = None
    ) -> list[mi.Float]:
        """Return Σ_i f(q_i - c_p) v_i for pixels p; with ``place``, Σ_p f(q_i - c_p) g_p."""
        size = self.width, self.height
        return _around_pixels(values, pixel, place, self.table, self.steps, self.spp, size)

    @property
    def _columns(self) -> mi.UInt32:
        """Return the width as an array: as a constant it would need new kernels for each size."""
        return dr.opaque(mi.UInt32, self.width)


@dr.syntax
def _around_pixels(
    values: list[mi.Float],
    pixel: mi.UInt32,
    place: mi.UInt32 | None,
    table: mi.Float,
    steps: int,
    spp: int,
    size: tuple[int, int],
) -> list[mi.Float]:
    """Sum around pixels (R,), weighted by the table of eq. 2.

    Without ``place``, over all samples that add to the pixel, from values (H W spp,). With it, over
    all pixels that a sample at this place (R,) in the pixel adds to, from values (H W,).
    """
    width, height = size
    y = mi.Int32(pixel // width)
    x = mi.Int32(pixel) - y * width
    total = [dr.zeros(mi.Float, dr.width(pixel)) for _ in values]
    side, sign = 2 * steps + 1, -1 if place is None else 1
    places = spp if place is None else 1
    j, end = mi.UInt32(0), dr.opaque(mi.UInt32, side * side * places)
    while j < end:
        step = j // places
        row = step // side
        px = x + sign * (mi.Int32(step - row * side) - steps)
        py = y + sign * (mi.Int32(row) - steps)
        valid = (px >= 0) & (py >= 0) & (px < width) & (py < height)
        item = mi.UInt32(py * width + px)
        if dr.hint(place is None, mode="scalar"):
            item = item * spp + (j - step * spp)
            f = dr.gather(mi.Float, table, j)
        else:
            f = dr.gather(mi.Float, table, j * spp + place)
        total = _add(total, f, values, item, valid)
        j += 1
    return total


def _add(
    total: list[mi.Float], f: mi.Float, values: list[mi.Float], item: mi.UInt32, valid: mi.Bool
) -> list[mi.Float]:
    """Add ``f`` times one entry of each array of values to the totals."""
    return [
        dr.fma(f, dr.gather(mi.Float, value, item, valid), sum_)
        for sum_, value in zip(total, values, strict=True)
    ]


def lattice(spp: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (x, y) of samples in a pixel, as in :meth:`PixelFilter.positions`.

    Example:
        >>> x, y = lattice(4)
        >>> x, y.round(2)
        (array([0.125, 0.375, 0.625, 0.875]), array([0.5 , 0.12, 0.74, 0.35]))
    """
    k = np.arange(spp)
    return (k + 0.5) / spp, (0.5 + k * GOLDEN_STEP) % 1


def column_and_row(pixel: mi.UInt32, columns: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """Return column and row of pixels that are numbered row by row.

    The division is in float64, which is exact here: a kernel divides floats in packets, and
    integers one by one.

    Example:
        >>> column_and_row(mi.UInt32(0, 5, 11), mi.UInt32(5))
        ([0, 0, 1], [0, 1, 2])
    """
    y = mi.UInt32((mi.Float64(pixel) + 0.5) * dr.rcp(mi.Float64(columns)))
    return pixel - y * columns, y


def _total(mass: np.ndarray, count: int) -> np.ndarray:
    """Return ∫ f over the pixels on the image, for each of ``count`` pixels in a row.

    ``mass`` is the integral over one pixel, by the step from it to the filter's pixel.
    """
    return np.convolve(np.ones(count), mass, mode="full")[len(mass) // 2 :][:count]


@dataclass(frozen=True)
class Tile:
    """A part of a view on a grid of its own.

    Example:
        8 x 8 pixels, half as wide as the view's, from (6, 6) on.

        >>> tile = Tile(left=6, top=6, scale=2, width=8, height=8)
        >>> tile.left + tile.width / tile.scale  # its right border in the view
        10.0
    """

    left: float  # of its upper left corner, pixels of the view
    top: float
    scale: float  # pixels of the tile per pixel of the view
    width: int  # pixels of the tile
    height: int


@dataclass(frozen=True)
class _Grid:
    """A tile in Dr.Jit arrays: with constants, kernels would be compiled for each tile."""

    corner: mi.Point2f  # pixels of the view
    scale: mi.Float
    size: mi.Point2f  # pixels of the tile
    columns: mi.UInt32
    start: mi.UInt32  # number of its first pixel among the pixels of all tiles


@dataclass(frozen=True)
class MultiCrop(PixelFilter):
    """The pixels of all tiles, one tile after the other, as an image of one row.

    Example:
        >>> box = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        >>> crops = MultiCrop.of([Tile(6, 6, 2, 2, 1), Tile(0, 0, 1, 1, 1)], mi.load_dict(box))
        >>> crops.positions().x, crops.positions().y  # of three pixels, in the view
        ([6.25, 6.75, 0.5], [6.25, 6.25, 0.5])
    """

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
        return MultiCrop(
            width=start, height=1, spp=1, steps=0, rfilter=film.rfilter(),
            table=one, discrete=one, continuous=one, grids=tuple(grids),
        )  # fmt: skip

    def positions(self, rays: mi.UInt32 | None = None) -> mi.Point2f:
        """Return the positions of the pixels' rays in the view (eq. 5)."""
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
        """Return the weights of rays (eq. 7); 1 for points, whose weights depend on the tile."""
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
        """Yield the pixel of each tile that holds a point of the view, with its weight (6, 7)."""
        for grid in self.grids:
            at = (q - grid.corner) * grid.scale
            valid = (at.x >= 0) & (at.y >= 0) & (at.x < grid.size.x) & (at.y < grid.size.y)
            x, y = (dr.select(valid, mi.UInt32(mi.Int32(p)), 0) for p in (at.x, at.y))
            weight = dr.square(grid.scale) if crowd is None else _share(grid.scale, crowd)
            yield grid.start + y * grid.columns + x, weight, valid


def _share(scale: mi.Float, crowd: mi.Float) -> mi.Float:
    """Evaluate eq. 7 with ``crowd`` = 1 / A."""
    return dr.square(scale) * dr.rcp(dr.square(scale) + crowd)
