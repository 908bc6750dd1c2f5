"""Choose the part of a film's pictures that may show the person, and the resolution to work at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LONGEST = 720  # pixels of the person's longer side at work: more costs time and shows no more
AROUND = 0.12  # of the person's longer side: margin on each side, which networks may have missed


@dataclass(frozen=True)
class WorkGrid:
    """A rectangle of the pictures, resampled to ``size``."""

    picture: tuple[int, int]  # (H, W) of the whole picture
    box: tuple[int, int, int, int]  # left, top, right, bottom, in pixels of the picture
    size: tuple[int, int]  # (h, w) of the grid

    @staticmethod
    def around(extents: np.ndarray, picture: tuple[int, int]) -> WorkGrid:
        """Return the grid around the person's extents (T, 4): left, top, right, bottom, pixels."""
        longer = (extents[:, 2:] - extents[:, :2]).max(1)
        border = np.ceil(AROUND * longer.max())
        low = np.maximum(extents[:, :2].min(0) - border, 0).astype(int)
        high = np.minimum(extents[:, 2:].max(0) + border, picture[::-1]).astype(int)
        scale = min(1.0, LONGEST / float(np.median(longer)))
        width, height = (max(1, round(float(x))) for x in (high - low) * scale)
        return WorkGrid(picture, (*low.tolist(), *high.tolist()), (height, width))

    @property
    def scale(self) -> float:
        """Pixels of the grid per pixel of the picture."""
        return self.size[0] / (self.box[3] - self.box[1])

    def heights(self, extent: np.ndarray) -> np.ndarray:
        """Return each row's height (h,): 0 at the top of an extent (4,) of pixels, 1 at its end."""
        rows = self.box[1] + (np.arange(self.size[0]) + 0.5) / self.scale
        return (rows - extent[1]) / (extent[3] - extent[1])

    def in_shares(self, A: np.ndarray) -> np.ndarray:
        """Convert an affine map (3, 3) of shares of the picture to one of shares of the grid.

        Shares go from -1 to 1 over the width and the height.
        """
        left, top, right, bottom = self.box
        pixels = lambda x0, y0, w, h: np.array(
            [[w / 2, 0, x0 + w / 2], [0, h / 2, y0 + h / 2], [0, 0, 1]]
        )
        whole = pixels(0, 0, *self.picture[::-1])
        part = np.linalg.inv(whole) @ pixels(left, top, right - left, bottom - top)
        return np.linalg.inv(part) @ A @ part

    def cut(self, image: np.ndarray) -> np.ndarray:
        """Return an image (H, W) or (H, W, C) of the whole picture, 8-bit, on the grid."""
        from PIL import Image

        left, top, right, bottom = self.box
        if self.size == (bottom - top, right - left):
            return np.ascontiguousarray(image[top:bottom, left:right])
        part = Image.fromarray(np.ascontiguousarray(image[top:bottom, left:right]))
        return np.asarray(part.resize(self.size[::-1], Image.Resampling.BILINEAR))

    def paste(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask (h, w) of the grid, in [0, 1], as the picture's (H, W), 8-bit."""
        from PIL import Image

        left, top, right, bottom = self.box
        part = Image.fromarray(np.round(mask * 255).astype(np.uint8))
        if self.size != (bottom - top, right - left):
            part = part.resize((right - left, bottom - top), Image.Resampling.BICUBIC)
        whole = np.zeros(self.picture, np.uint8)
        whole[top:bottom, left:right] = np.asarray(part)
        return whole
