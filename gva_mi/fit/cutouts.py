"""The person of each training frame, and what is behind them where the mask may be wrong.

Between two shins, say, all of the background lies near an outline. The picture tells background
from person there only if the background is known: with a wrong one, Gaussians in the colours of the
floor would fill the gap. A camera that stands still shows it in other frames
(:mod:`gva_mi.data.matting.plate`). Where no frame does, or where the plate disagrees with what is
seen nearby, the nearest background of the same frame takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.data import backdrop
from gva_mi.data.crop import Box
from gva_mi.data.matting.plate import Plate
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.video import Frame


@dataclass(frozen=True)
class Person:
    """A person cut out of a frame."""

    pixels: Tensor  # (h, w, 4) uint8, picture and mask
    kept: Box  # their place in the whole picture
    box: Box  # around the inside of the mask, in the whole picture
    error: float  # pixels by which the mask's outline may be off

    @staticmethod
    def of(frame: Frame, mask_error: float) -> Person:
        """Cut a frame; ``mask_error`` is a share of the root of the area of the person's box."""
        box = _box_of(frame.mask > 0.5)
        error = mask_error * (box.width * box.height) ** 0.5
        kept = _box_of(frame.mask > 0, math.ceil(error) + 1)
        return Person(_to_8bit(kept.cut(frame.image), kept.cut(frame.mask)), kept, box, error)

    @property
    def picture(self) -> np.ndarray:
        """The picture (h, w, 3) in [0, 1]."""
        return self.pixels[..., :3].numpy().astype(np.float32) / 255

    @property
    def mask(self) -> np.ndarray:
        """The mask (h, w) in [0, 1]."""
        return self.pixels[..., 3].numpy().astype(np.float32) / 255

    @property
    def unsure(self) -> np.ndarray:
        """Where the mask may be wrong (h, w) bool."""
        return backdrop.unsure(self.mask, self.error)

    @property
    def bare(self) -> np.ndarray:
        """Where the person surely is not (h, w) bool."""
        return (self.mask == 0) & ~self.unsure

    def behind(self, plate: Plate | None, place: Box) -> Tensor:
        """Return what is behind the person and where the mask is uncertain (h, w, 4) uint8.

        ``plate`` is what :func:`background_of` found in the part ``place`` of the picture. Without
        it, or where it disagrees with this frame, the nearest background of this frame is taken.
        """
        image, unsure = self.picture, self.unsure
        bare = (self.mask == 0) & ~unsure
        if plate is None or not bare.any():
            return _to_8bit(backdrop.behind(image, np.maximum(self.mask, unsure)), unsure)
        part = plate.part(within(self.kept, place)).agreeing(image, bare)
        return _to_8bit(np.where(bare[..., None], image, part.beside(image, bare)), unsure)


def background_of(frames: Iterable[tuple[Frame, Person]], place: Box) -> Plate:
    """Return the background that frames of one camera show in a part of the picture."""
    pictures, bare = [], []
    for frame, person in frames:
        pictures.append(in_8_bits(place.cut(frame.image)))
        bare.append(np.ones((place.height, place.width), bool))
        bare[-1][within(person.kept, place)] = person.bare
    return Plate.gather(np.stack(pictures), np.stack(bare))


def within(box: Box, part: Box) -> tuple[slice, slice]:
    """Return rows and columns of a box in a larger one."""
    top, left = box.top - part.top, box.left - part.left
    return slice(top, top + box.height), slice(left, left + box.width)


def _to_8bit(image: np.ndarray, fourth: np.ndarray) -> Tensor:
    """Pack an image (H, W, 3) and a fourth channel (H, W), all in [0, 1], as 8 bits."""
    four = np.concatenate([image, fourth[..., None]], axis=-1)
    return torch.from_numpy(np.round(four * 255).astype(np.uint8))


def _box_of(mask: np.ndarray, margin: int = 0) -> Box:
    """Return the box around a mask (H, W) bool; the whole picture if it is empty."""
    H, W = mask.shape
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    if not len(rows):
        return Box(0, 0, W, H)
    left, top = max(0, int(columns[0]) - margin), max(0, int(rows[0]) - margin)
    right, bottom = min(W, int(columns[-1]) + 1 + margin), min(H, int(rows[-1]) + 1 + margin)
    return Box(left, top, right, bottom)
