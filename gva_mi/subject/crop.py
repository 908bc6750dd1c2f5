"""Crop a frame around the person and shrink it, or give the reason why it shows nobody.

Cropping comes first, so that the person's size decides the resolution, and not the picture's.
Shrinking lays a coarser grid over the image; both share the upper left corner. With the scale
``s``, pixels of the grid per pixel of the image:

1. Pixel ``(i, j)`` of the grid covers ``[i, i + 1) x [j, j + 1)``, divided by ``s``.
2. It holds the mean over this area; pixels that lie in it partly count by that part.
3. The camera of the grid has ``s`` times the focal lengths and the principal point.

So the images of a video on one grid show the person at one scale, wherever they are cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.spill_cache import SpillCache
from gva_mi.splat import Camera

EMPTY_MASK_PIXELS = 16  # a mask of a smaller area counts as empty. Chosen: it shows no pose

Image = TypeVar("Image", np.ndarray, Tensor)
Seen = TypeVar("Seen")


class Numbered(Protocol):
    """What a video yields: a ``Frame``, or a ``FrameWithoutPicture``."""

    index: int


Read = TypeVar("Read", bound=Numbered)


class NoEvidence(Exception):
    """The reason why a frame is no evidence of the pose; such a frame keeps its pose."""


@dataclass(frozen=True)
class Box:
    """A part of an image, in whole pixels; ``right`` and ``bottom`` lie just outside."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        return self.right - self.left

    @property
    def height(self) -> int:
        return self.bottom - self.top

    def cut(self, image: Image) -> Image:
        """Return the part of an image (H, W, ...) inside the box."""
        return image[self.top : self.bottom, self.left : self.right]

    def cut_camera(self, camera: Camera) -> Camera:
        """Return the camera that sees this part of its image."""
        return camera.cropped(self.left, self.top, self.width, self.height)


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


@dataclass(frozen=True)
class ScaledCrop:
    """A part of an image on a coarser grid; on the image's own if ``scale`` is 1."""

    scale: float  # pixels of the grid per pixel of the image, at most 1
    box: Box  # in pixels of the grid

    @staticmethod
    def around(extent: Extent, camera: Camera, scale: float, margin: float) -> ScaledCrop:
        """Return the crop around an extent, both inside the camera's image.

        ``margin`` is added on each side, as a fraction of the extent's longer side.
        """
        whole = Extent(extent.low * scale, extent.high * scale)
        # A last column or row that the image fills only partly is left out.
        size = np.array([camera.width, camera.height]) * scale
        return ScaledCrop(scale, whole.box(margin, np.maximum(np.floor(size + 1e-6), 1)))

    def cut_camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the crop (eq. 3)."""
        scaled = {name: getattr(camera, name) * self.scale for name in ("fx", "fy", "cx", "cy")}
        return self.box.cut_camera(replace(camera, **scaled))

    def cover(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and columns of an image (height, width) that the crop touches."""
        box, s = self.box, self.scale
        return tuple(
            slice(min(size - 1, math.floor(low / s)), min(size, math.ceil(high / s)))
            for low, high, size in ((box.top, box.bottom, height), (box.left, box.right, width))
        )

    def shrink(self, image: np.ndarray, part: tuple[slice, slice]) -> Tensor:
        """Return means (H, W, ...) over the areas of the grid's pixels (eq. 2).

        ``image`` (h, w) or (h, w, C), floating point, is the part that :meth:`cover` gives.
        """
        shrunk = image
        if self.scale != 1:
            rows = _shares(self.box.top, self.box.height, self.scale, part[0])
            columns = _shares(self.box.left, self.box.width, self.scale, part[1])
            shrunk = _mixed_rows(rows, shrunk)
            shrunk = _mixed_rows(columns, shrunk.swapaxes(0, 1)).swapaxes(0, 1)
        return torch.from_numpy(np.ascontiguousarray(shrunk))


@dataclass(frozen=True)
class Extent:
    """A rectangle on an image, in pixels."""

    low: np.ndarray  # (2,) left, top
    high: np.ndarray  # (2,) right, bottom

    @property
    def longer(self) -> float:
        """The longer side."""
        return float((self.high - self.low).max())

    def joined(self, other: Extent) -> Extent:
        """Return the smallest extent that contains both."""
        return Extent(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def box(self, margin: float, size: np.ndarray) -> Box:
        """Return whole pixels around it, inside an image of ``size`` (2,): width, height.

        ``margin`` is added on each side, as a fraction of the longer side.
        """
        border = margin * self.longer
        left, top = np.clip(np.floor(self.low - border), 0, size - 1).astype(int)
        right, bottom = np.clip(np.ceil(self.high + border), [left + 1, top + 1], size).astype(int)
        return Box(int(left), int(top), int(right), int(bottom))


def bounds(mask: np.ndarray) -> np.ndarray | None:
    """Return left, top, right, bottom (4,), pixels, of a mask (H, W) bool; None if it is empty."""
    columns, rows = (np.flatnonzero(mask.any(axis)) for axis in (0, 1))
    if not len(rows):
        return None
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)


def mask_extent(mask: np.ndarray) -> Extent:
    """Return the extent of a mask (H, W) in [0, 1].

    Raises:
        NoEvidence: it is empty.
    """
    if mask.sum() < EMPTY_MASK_PIXELS:
        raise NoEvidence("its mask is empty")
    low, high = bounds(mask > 0.5 * mask.max()).reshape(2, 2)
    return Extent(low, high)


def points_extent(points: np.ndarray, camera: Camera, shown: str) -> Extent:
    """Return the extent of projected points, which may exceed the image.

    Args:
        points: (N, 3) float64, world, metres.
        camera: of the image.
        shown: what the points belong to, such as "its stage-1 body", for messages.

    Raises:
        NoEvidence: the camera does not see the points.
    """
    if camera.depths(points).min() <= 0:
        raise NoEvidence(f"{shown} reaches behind the camera")
    pixels = camera.project(points)
    low, high = pixels.min(0), pixels.max(0)
    if (high < 0).any() or (low > [camera.width, camera.height]).any():
        raise NoEvidence(f"{shown} is out of view")
    return Extent(low, high)


def person_extent(mask: np.ndarray, camera: Camera, points: np.ndarray, shown: str) -> Extent:
    """Return the extent of a person's mask and of the points of their model.

    Both are needed: the model may lie outside the mask, and an optimiser has to see it there. For
    arguments and errors see :func:`mask_extent` and :func:`points_extent`.
    """
    return mask_extent(mask).joined(points_extent(points, camera, shown))


def block_means(image: np.ndarray, side: int) -> np.ndarray:
    """Return the means (H // side, W // side, ...) of square blocks of an image (H, W, ...)."""
    if side == 1:
        return image
    h, w = image.shape[0] // side, image.shape[1] // side
    total = np.zeros((h, w, *image.shape[2:]), np.float32)
    for row in range(side):  # numpy's mean over two axes takes three times as long
        columns = [image[row : h * side : side, k : w * side : side] for k in range(side)]
        total += sum(columns[1:], columns[0].astype(np.float32))
    return total / np.float32(side * side)


def gather(
    frames: Iterable[int],
    absent: Mapping[int, str],
    read: Callable[[Iterable[int]], Iterable[Read]],
    look: Callable[[Read], Seen],
    found: dict[int, Seen] | SpillCache[Seen],
) -> dict[int, str]:
    """Gather the evidence of the wanted frames; return why the other ones have none.

    Args:
        frames: numbers of the frames that are used.
        absent: frames that cannot be read, and why.
        read: reads frames by their numbers, such as :meth:`gva_mi.subject.video.Video.outlines`.
        look: makes evidence from a frame, or raises :class:`NoEvidence`.
        found: receives the evidence.
    """
    wanted = list(frames)
    reasons = {k: absent[k] for k in wanted if k in absent}
    for frame in read(k for k in wanted if k not in absent):
        try:
            found[frame.index] = look(frame)
        except NoEvidence as reason:
            reasons[frame.index] = str(reason)
    return reasons


def _shares(first: int, count: int, scale: float, part: slice) -> np.ndarray:
    """Return weights (count, w) of w image pixels in grid pixels along one axis; rows sum to 1.

    ``first`` and ``count`` are the grid's pixels, ``part`` the image's.
    """
    start = (np.arange(count) + first)[:, None]
    pixel = np.arange(part.start, part.stop)
    covered = np.minimum((start + 1) / scale, pixel + 1) - np.maximum(start / scale, pixel)
    covered = np.maximum(covered, 0)
    return covered / covered.sum(1, keepdims=True)


def _mixed_rows(shares: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return weighted sums (H, w, ...) of the rows of an image (h, w, ...), by weights (H, h)."""
    from scipy.sparse import csr_matrix  # nearly all weights are zero

    mixed = csr_matrix(shares.astype(image.dtype)) @ image.reshape(len(image), -1)
    return mixed.reshape(len(shares), *image.shape[1:])
