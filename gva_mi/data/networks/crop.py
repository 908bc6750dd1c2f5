"""Cut the person out for a network: a rectangle of whole pixels, which may cross the border."""

from __future__ import annotations

import numpy as np

from gva_mi.data.crop import Box


class CropBox(Box):
    """A rectangle of a picture that a network sees, resized."""

    @staticmethod
    def round_box(box: np.ndarray, margin: float, size: tuple[int, int] = (1, 1)) -> CropBox:
        """Return the rectangle around a box (4,) left, top, right, bottom, with ``size``'s aspect.

        ``size`` is (w, h). ``margin`` of the box's longer side is added on each side at least.
        """
        low, high = np.asarray(box[:2], np.float64), np.asarray(box[2:], np.float64)
        needed = high - low + 2 * margin * (high - low).max()
        unit = float((needed / size).max())
        width, height = (max(1, round(unit * n)) for n in size)
        left, top = np.round((low + high - (width, height)) / 2).astype(int).tolist()
        return CropBox(left, top, left + width, top + height)

    def resized(
        self, image: np.ndarray, size: tuple[int, int], fill: tuple[int, int, int]
    ) -> np.ndarray:
        """Cut the rectangle from a picture (H, W, 3) 8-bit, and resize it to ``size`` (w, h).

        What lies outside of the picture gets the colour ``fill``.
        """
        from PIL import Image

        canvas = Image.new("RGB", (self.width, self.height), fill)
        canvas.paste(Image.fromarray(image), (-self.left, -self.top))
        return np.asarray(canvas.resize(size, Image.Resampling.BILINEAR))

    def to_network(self, pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Convert picture pixels (..., 2) to pixels of the resized rectangle of ``size`` (w, h)."""
        scale = np.array(size) / (self.width, self.height)
        return (np.asarray(pixels, np.float64) - (self.left, self.top)) * scale
