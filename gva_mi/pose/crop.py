"""Cutting a frame to the surroundings of the person, or saying why it does not show the person."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
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


def person_box(
    mask: np.ndarray, camera: Camera, points: np.ndarray, margin: float, shown: str
) -> Box:
    """The box around a person's mask and around points of the person's model.

    Both are needed: the model may lie outside the mask, and an optimiser must see it there.

    Args:
        mask: (H, W) in [0, 1].
        camera: of the picture.
        points: (N, 3) float64, world, metres.
        margin: added on each side, as a fraction of the box's longer side.
        shown: what the points belong to, such as "its stage-1 body", for the reasons.

    Raises:
        NoEvidence: the mask is empty, or the points are not seen by the camera.
    """
    if mask.sum() < SMALLEST:
        raise NoEvidence("its mask is empty")
    T = camera.T_camera_world
    if (points @ T[2, :3] + T[2, 3]).min() <= 0:
        raise NoEvidence(f"{shown} reaches behind the camera")
    pixels = camera.project(points)
    size = np.array([camera.width, camera.height])
    if (pixels.max(0) < 0).any() or (pixels.min(0) > size).any():
        raise NoEvidence(f"{shown} is out of view")
    rows, columns = np.nonzero(mask > 0.5 * mask.max())
    low = np.minimum(pixels.min(0), [columns.min(), rows.min()])
    high = np.maximum(pixels.max(0), [columns.max() + 1, rows.max() + 1])
    border = margin * (high - low).max()
    left, top = np.clip(np.floor(low - border), 0, size - 1).astype(int)
    right, bottom = np.clip(np.ceil(high + border), [left + 1, top + 1], size).astype(int)
    return Box(int(left), int(top), int(right), int(bottom))
