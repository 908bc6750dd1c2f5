"""Cutting a frame to the surroundings of the person, or saying why it does not show the person.

A frame is cut first and shrunk afterwards, so that the person's size decides how fine the picture
is, and not the size of the room. Shrinking lays a coarser grid over the picture, with both left
upper corners in one place. With the scale ``s``, pixels of the grid for one of the picture:

1. Pixel ``(i, j)`` of the grid covers ``[i, i + 1) x [j, j + 1)``, divided by ``s``.
2. It holds the mean over this area: pixels that lie in it partly count by that part.
3. The camera of the grid has ``s`` times the focal lengths and the principal point.

So the pictures of a video on one grid show the person at one scale, wherever they are cut.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from gva_mi.splat import Camera

SMALLEST = 16  # pixels: a mask of a smaller area counts as empty

Image = TypeVar("Image", np.ndarray, Tensor)


class NoEvidence(Exception):
    """Why a frame says nothing about the pose. The frame keeps its pose, and nothing stops."""


@dataclass(frozen=True)
class Box:
    """A part of a picture, in whole pixels; ``right`` and ``bottom`` lie just outside."""

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
        """The part of a picture (H, W, ...) inside the box."""
        return image[self.top : self.bottom, self.left : self.right]

    def cut_camera(self, camera: Camera) -> Camera:
        """The camera that sees this part of its picture."""
        return camera.cropped(self.left, self.top, self.width, self.height)


@dataclass(frozen=True)
class Crop:
    """A part of a picture on a coarser grid; on the picture's own, where ``scale`` is 1."""

    scale: float  # pixels of the grid for one of the picture, at most 1
    box: Box  # in pixels of the grid

    @staticmethod
    def around(extent: Extent, camera: Camera, scale: float, margin: float) -> Crop:
        """The crop around an extent, inside the picture.

        Args:
            extent: in pixels of the picture.
            camera: of the picture.
            scale: of the grid.
            margin: added on each side, as a fraction of the extent's longer side.
        """
        whole = Extent(extent.low * scale, extent.high * scale)
        # A last column or row that the picture fills only partly is left out.
        size = np.array([camera.width, camera.height]) * scale
        return Crop(scale, whole.box(margin, np.maximum(np.floor(size + 1e-6), 1)))

    def cut_camera(self, camera: Camera) -> Camera:
        """The camera that sees the crop (eq. 3)."""
        scaled = replace(
            camera,
            fx=camera.fx * self.scale,
            fy=camera.fy * self.scale,
            cx=camera.cx * self.scale,
            cy=camera.cy * self.scale,
        )
        return self.box.cut_camera(scaled)

    def cover(self, height: int, width: int) -> tuple[slice, slice]:
        """The rows and columns of a picture of some size that the crop touches."""
        box, s = self.box, self.scale
        return tuple(
            slice(min(size - 1, math.floor(low / s)), min(size, math.ceil(high / s)))
            for low, high, size in ((box.top, box.bottom, height), (box.left, box.right, width))
        )

    def shrink(self, image: np.ndarray, part: tuple[slice, slice]) -> Tensor:
        """Means over the areas of the grid's pixels (eq. 2).

        Args:
            image: (h, w) or (h, w, C) floating point, the part of the picture that is covered.
            part: as :meth:`cover` gives it.

        Returns:
            (H, W) or (H, W, C), of the size of the box.
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
    """A rectangle on a picture, in pixels."""

    low: np.ndarray  # (2,) left, top
    high: np.ndarray  # (2,) right, bottom

    @property
    def longer(self) -> float:
        """The longer side."""
        return float((self.high - self.low).max())

    def joined(self, other: Extent) -> Extent:
        """The least one that holds both."""
        return Extent(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def box(self, margin: float, size: np.ndarray) -> Box:
        """Whole pixels around it, inside a picture of some size (2,): width, height.

        Args:
            margin: added on each side, as a fraction of the longer side.
            size: of the picture.
        """
        border = margin * self.longer
        left, top = np.clip(np.floor(self.low - border), 0, size - 1).astype(int)
        right, bottom = np.clip(np.ceil(self.high + border), [left + 1, top + 1], size).astype(int)
        return Box(int(left), int(top), int(right), int(bottom))


def mask_extent(mask: np.ndarray) -> Extent:
    """The extent of a mask (H, W) in [0, 1].

    Raises:
        NoEvidence: it is empty.
    """
    if mask.sum() < SMALLEST:
        raise NoEvidence("its mask is empty")
    inside = mask > 0.5 * mask.max()
    columns, rows = (np.flatnonzero(inside.any(axis)) for axis in (0, 1))
    return Extent(
        np.array([columns[0], rows[0]], np.float64),
        np.array([columns[-1] + 1, rows[-1] + 1], np.float64),
    )


def points_extent(points: np.ndarray, camera: Camera, shown: str) -> Extent:
    """The extent of points on a picture, also where it reaches out of the picture.

    Args:
        points: (N, 3) float64, world, metres.
        camera: of the picture.
        shown: what the points belong to, such as "its stage-1 body", for the reasons.

    Raises:
        NoEvidence: the points are not seen by the camera.
    """
    T = camera.T_camera_world
    if (points @ T[2, :3] + T[2, 3]).min() <= 0:
        raise NoEvidence(f"{shown} reaches behind the camera")
    pixels = camera.project(points)
    low, high = pixels.min(0), pixels.max(0)
    if (high < 0).any() or (low > [camera.width, camera.height]).any():
        raise NoEvidence(f"{shown} is out of view")
    return Extent(low, high)


def person_extent(mask: np.ndarray, camera: Camera, points: np.ndarray, shown: str) -> Extent:
    """The extent of a person's mask and of points of the person's model.

    Both are needed: the model may lie outside the mask, and an optimiser must see it there.

    Args:
        mask: (H, W) in [0, 1].
        camera: of the picture.
        points: (N, 3) float64, world, metres.
        shown: what the points belong to, such as "its stage-1 body", for the reasons.

    Raises:
        NoEvidence: the mask is empty, or the points are not seen by the camera.
    """
    return mask_extent(mask).joined(points_extent(points, camera, shown))


def person_box(
    mask: np.ndarray, camera: Camera, points: np.ndarray, margin: float, shown: str
) -> Box:
    """The box of whole pixels around :func:`person_extent`.

    Args:
        mask, camera, points, shown: as there.
        margin: added on each side, as a fraction of the longer side.

    Raises:
        NoEvidence: the mask is empty, or the points are not seen by the camera.
    """
    extent = person_extent(mask, camera, points, shown)
    return extent.box(margin, np.array([camera.width, camera.height]))


def _shares(first: int, count: int, scale: float, part: slice) -> np.ndarray:
    """How much of each of the grid's pixels along one axis is covered by which of the picture's.

    Args:
        first, count: of the grid's pixels.
        scale: of the grid.
        part: of the picture's pixels.

    Returns:
        (count, pixels of the part); rows add up to 1.
    """
    start = (np.arange(count) + first)[:, None]
    pixel = np.arange(part.start, part.stop)
    covered = np.minimum((start + 1) / scale, pixel + 1) - np.maximum(start / scale, pixel)
    covered = np.maximum(covered, 0)
    return covered / covered.sum(1, keepdims=True)


def _mixed_rows(shares: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Rows (H, w, ...) that are sums of rows of an image (h, w, ...), by their shares (H, h)."""
    from scipy.sparse import csr_matrix  # nearly all shares are zero

    mixed = csr_matrix(shares.astype(image.dtype)) @ image.reshape(len(image), -1)
    return mixed.reshape(len(shares), *image.shape[1:])
