"""``TurnedSquare``: the rotated square of a picture that a landmark network sees upright.

Places in a square are (u, v) in [0, 1], u to its right and v down. Pixels of the picture are
(x, y); the centre of the first pixel is (0.5, 0.5)::

    (x, y) = centre + side R(angle) (u − 1/2, v − 1/2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TurnedSquare:
    """A square of a picture, turned clockwise by ``angle``."""

    centre: tuple[float, float]  # x, y pixels
    side: float  # pixels
    angle: float = 0.0  # radians

    @staticmethod
    def upright(centre: np.ndarray, top: np.ndarray, side: float) -> TurnedSquare:
        """Return the square around ``centre`` (2,) in which ``top`` (2,) lies straight above."""
        x, y = (top - centre).tolist()
        return TurnedSquare((float(centre[0]), float(centre[1])), float(side), math.atan2(x, -y))

    def scaled(self, factor: float) -> TurnedSquare:
        """Return a square with the same centre and another side."""
        return TurnedSquare(self.centre, self.side * factor, self.angle)

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Turn vectors (..., 2 or 3) from the square's axes to the picture's; z stays."""
        turned = np.array(vectors, np.float64)
        turned[..., :2] = turned[..., :2] @ self._rotation().T
        return turned

    def to_picture(self, places: np.ndarray) -> np.ndarray:
        """Convert places (..., 2) in the square to pixels of the picture."""
        return self.side * self.turn(np.asarray(places) - 0.5) + self.centre

    def from_picture(self, pixels: np.ndarray) -> np.ndarray:
        """Convert pixels (..., 2) of the picture to places in the square."""
        return (np.asarray(pixels) - self.centre) @ self._rotation() / self.side + 0.5

    def cut(self, image: np.ndarray, size: int, edge: bool = True) -> np.ndarray:
        """Resample the square of a picture (H, W, 3) 8-bit to (size, size, 3) float32 in [0, 1].

        Beyond the picture's border, the nearest pixel is repeated, or with ``edge`` false all is
        black. Pixels are averaged before a picture is shrunk, so that thin things do not alias.
        """
        from PIL import Image

        corners = self.to_picture(np.array([[0, 0], [1, 0], [0, 1], [1, 1]]))
        low = np.floor(corners.min(0)).astype(int) - 2
        high = np.ceil(corners.max(0)).astype(int) + 2
        sides = np.array(image.shape[1::-1])
        # Take at least one pixel of the picture, even if the square lies outside it.
        (left, top), (right, bottom) = low.clip(0, sides - 1), high.clip(1, sides)
        seen = Image.fromarray(np.ascontiguousarray(image[top:bottom, left:right]))
        shrink = max(1.0, self.side / size)  # picture's pixels in one of the network's
        small = (max(1, round(seen.width / shrink)), max(1, round(seen.height / shrink)))
        if shrink > 1:
            seen = seen.resize(small, Image.Resampling.BOX)
        scale = np.array([seen.width / (right - left), seen.height / (bottom - top)])
        before = np.ceil((np.array([left, top]) - low).clip(0) * scale).astype(int)
        after = np.ceil((high - (right, bottom)).clip(0) * scale).astype(int)
        around = ((before[1], after[1]), (before[0], after[0]), (0, 0))
        padded = np.pad(np.asarray(seen), around, mode="edge" if edge else "constant")
        # Places of the network's pixels in the padded picture: an affine map of PIL's.
        A = scale[:, None] * self._rotation() * (self.side / size)
        start = (self.to_picture(np.zeros(2)) - (left, top)) * scale + before
        rows = np.concatenate([A, start[:, None]], axis=1)
        taken = Image.fromarray(padded).transform(
            (size, size), Image.Transform.AFFINE, rows.ravel().tolist(), Image.Resampling.BILINEAR
        )
        return np.asarray(taken, np.float32) / 255

    def put_back(self, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Resample a map (s, s) of the square to a picture (H, W) float32; 0 outside of it."""
        from PIL import Image

        size, (height, width) = len(values), shape
        corners = self.to_picture(np.array([[0, 0], [1, 0], [0, 1], [1, 1]]))
        left, top = np.floor(corners.min(0)).astype(int).clip(0)
        right, bottom = np.minimum(np.ceil(corners.max(0)).astype(int), (width, height))
        whole = np.zeros(shape, np.float32)
        if right > left and bottom > top:
            A = self._rotation().T * (size / self.side)
            start = A @ (np.array([left, top]) - self.to_picture(np.zeros(2)))
            rows = np.concatenate([A, start[:, None]], axis=1)
            part = Image.fromarray(values.astype(np.float32)).transform(
                (int(right - left), int(bottom - top)), Image.Transform.AFFINE,
                rows.ravel().tolist(), Image.Resampling.BILINEAR,
            )  # fmt: skip
            whole[top:bottom, left:right] = np.asarray(part)
        return whole

    def _rotation(self) -> np.ndarray:
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s], [s, c]])
