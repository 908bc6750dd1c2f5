"""gsplat's lists of who is in which tile, handed to the kernels in tiles of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from gva_mi.splat.kernels.tiles import HEIGHT, WIDTH, Layout, Lists, lists_of

NAME = "rasterize_to_pixels()"


@dataclass(frozen=True)
class TileLists:
    """gsplat's lists on the host, checked."""

    offsets: (
        np.ndarray
    )  # (I, tiles + 1) where each tile's list starts in ids, and the last one's end
    ids: np.ndarray  # (n_isects,) rows
    shown: np.ndarray | None  # (I, tiles)
    of_ours: np.ndarray  # which of gsplat's tiles each of the kernels' lies in

    @staticmethod
    def of(
        offsets: Tensor, ids: Tensor, masks: Tensor | None, size: int, layout: Layout, rows: int
    ) -> TileLists:
        """Checks what would have the kernels read elsewhere.

        Raises:
            ValueError: the tiles do not cover the picture, or lists name what is not there.
        """
        height, width = offsets.shape[-2:]
        if size < WIDTH or size % WIDTH:
            raise ValueError(f"{NAME}: tile_size must be a multiple of {WIDTH}, got {size}")
        if height * size < layout.height or width * size < layout.width:
            found = f"{width}x{height} tiles of {size} px for {layout.width}x{layout.height}"
            raise ValueError(f"{NAME}: isect_offsets must cover the picture, got {found}")
        starts = offsets.reshape(-1).long().numpy()
        bounds = np.append(starts, len(ids))
        if (np.diff(bounds) < 0).any() or (len(starts) and starts[0] < 0):
            raise ValueError(f"{NAME}: isect_offsets must ascend from 0 to {len(ids)} at most")
        numbers = ids.long().numpy()
        if len(ids) and not (numbers.min() >= 0 and numbers.max() < rows):
            found = f"{numbers.min()} to {numbers.max()}"
            raise ValueError(f"{NAME}: flatten_ids must be 0 to {rows - 1}, got {found}")
        of_images = starts.reshape(-1, height * width)
        ends = bounds[1:].reshape(of_images.shape)[:, -1:]
        down, across = np.arange(layout.rows) * HEIGHT, np.arange(layout.columns) * WIDTH
        of_ours = (down // size)[:, None] * width + across // size
        shown = None if masks is None else masks.reshape(of_images.shape).bool().numpy()
        return TileLists(np.hstack([of_images, ends]), numbers, shown, of_ours.reshape(-1))

    def rows(self, image: int) -> slice:
        """Rows of a picture's Gaussians: from the first to the last that a list names."""
        ids = self.ids[self.offsets[image, 0] : self.offsets[image, -1]]
        return slice(int(ids.min()), int(ids.max()) + 1) if len(ids) else slice(0, 0)

    def lists(self, image: int, boxes: np.ndarray, layout: Layout, U: type) -> Lists | None:
        """A picture's lists for the kernels; None where nothing is to be drawn.

        Args:
            image: which.
            boxes: (n, 4) px, left, top, right, bottom of what the rows of the picture reach.
            layout: the picture in the kernels' tiles.
            U: unsigned integers.
        """
        first, last = self.offsets[image, :-1], self.offsets[image, 1:]
        counts = (
            last - first if self.shown is None else np.where(self.shown[image], last - first, 0)
        )
        counts, begin = counts[self.of_ours], first[self.of_ours]
        tile = np.repeat(np.arange(layout.tiles), counts)
        within = np.arange(len(tile)) - np.repeat(np.cumsum(counts) - counts, counts)
        ids = self.ids[begin[tile] + within] - self.rows(image).start
        x, y = tile % layout.columns * WIDTH + 0.5, tile // layout.columns * HEIGHT + 0.5
        left, top, right, bottom = boxes[ids].T
        reached = (left <= x + WIDTH - 1) & (right >= x) & (top <= y + HEIGHT - 1) & (bottom >= y)
        ids, tile = ids[reached], tile[reached]
        if not len(ids):
            return None
        numbers = np.arange(layout.tiles)
        start, end = np.searchsorted(tile, numbers), np.searchsorted(tile, numbers, side="right")
        return lists_of(ids, start, end, len(boxes), U)
