"""Colours over a whole film, by height: a head and a shoe share few, and so do wall and floor.

The density of a colour is counted in bins of RGB, once for all heights and once for each of some
bands from top to bottom, and blurred, as few colours are seen exactly again.
"""

from __future__ import annotations

import numpy as np

BITS = 6  # of each channel: 64 bins
BANDS = 8  # of the height
BLUR = 1.0  # bins, standard deviation
ANYWHERE, UNKNOWN = 0.1, 0.05  # shares of the colours of all heights, and of any colour at all


class ColorsByHeight:
    """How likely a colour is at a height, of the person or of the background."""

    def __init__(self) -> None:
        bins = 1 << BITS
        self._count = np.zeros((BANDS, bins, bins, bins), np.float32)
        self._density: np.ndarray | None = None

    def add(self, image: np.ndarray, inside: np.ndarray, height: np.ndarray) -> None:
        """Count the colours of a picture (h, w, 3) 8-bit where ``inside`` (h, w) bool.

        ``height`` (h,) is that of each row: 0 at the top of the person, or of the grid, 1 at the
        bottom.
        """
        place = _band(height)[:, None], *np.moveaxis(image >> (8 - BITS), -1, 0)
        flat = np.ravel_multi_index(np.broadcast_arrays(*place), self._count.shape)
        counted = np.bincount(flat[inside], minlength=self._count.size)
        self._count += counted.reshape(self._count.shape)

    def density(self, image: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return the density (h, w) of a picture's colours, relative to a uniform one.

        Arguments are those of :meth:`add`.
        """
        if self._density is None:
            self._density = self._estimate()
        return self._density[_band(height)[:, None], *np.moveaxis(image >> (8 - BITS), -1, 0)]

    def _estimate(self) -> np.ndarray:
        """Blur and mix the counts, and scale them so that a uniform density is 1."""
        from scipy.ndimage import gaussian_filter

        smooth = gaussian_filter(self._count, (0.7, BLUR, BLUR, BLUR))
        every = smooth.sum(0, keepdims=True)
        share = lambda x: x / np.maximum(x.sum((1, 2, 3), keepdims=True), 1e-6)
        bins = self._count[0].size
        mixed = (1 - ANYWHERE - UNKNOWN) * share(smooth) + ANYWHERE * share(every)
        return (mixed * bins + UNKNOWN).astype(np.float32)


def _band(height: np.ndarray) -> np.ndarray:
    return np.clip((height * BANDS).astype(int), 0, BANDS - 1)
