"""What a frame shows of the person, and how well an avatar in some pose agrees with it.

The avatar is laid over the picture and compared with it:

    1. P = C + (1 - A) I
    2. L = (|P - I| + λα |A - S| + λs (1 - SSIM(P, I))) · H W / Σ S

=============  ==================  =============================================================
symbol         code name           meaning
=============  ==================  =============================================================
C (H, W, 3)    ``image.color``     the render on black, so that it is what the avatar adds
A (H, W)       ``image.alpha``     how much of the picture the avatar covers
I (H, W, 3)    ``sight.picture``   the picture, cut to the person's surroundings
S (H, W)       ``sight.mask``      the mask; divided by its sum, a weight means the same for any
                                   size of the person
=============  ==================  =============================================================

with ``|·|`` a mean over the image. Where the picture is cut out by its mask instead, as in Eq. 13,
outlines follow the mask's errors, and poses with them: the loss falls, and the avatar comes no
closer to the person. Eq. 1 leaves to the mask no more than where an avatar should be.

Pictures keep their resolution. In a smaller one the avatar has another outline than in those that
it learned from, and poses make up for it in depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.data.video import Frame
from gva_mi.fit.losses import ssim
from gva_mi.splat import Camera, SplatOptions
from gva_mi.splat.torch_op import render

MARGIN = 0.1  # of the box around the person, added on each side
SMALLEST = 16  # pixels: a smaller mask is taken for an empty one, a smaller box for no view
SPLAT = SplatOptions(depth=False)


@dataclass(frozen=True)
class PictureWeights:
    """Of the terms of eq. 2; that of the picture is 1."""

    alpha: float  # λα
    ssim: float  # λs


class Hidden(Exception):
    """Why a frame says nothing of a pose; nothing stops for it."""


@dataclass(frozen=True)
class Sight:
    """One frame, cut to the person. Kept as 8 bits, as it was read: videos are long."""

    camera: Camera  # of the part that was cut out
    picture: Tensor  # (H, W, 3) uint8
    mask: Tensor  # (H, W) uint8

    @staticmethod
    def of(frame: Frame, points: np.ndarray) -> Sight:
        """Cut a frame to the box around its mask and some points (N, 3) of the world.

        Raises:
            Hidden: the mask is empty, or the points are not seen by the camera.
        """
        left, top, right, bottom = _box(frame, points)
        rows, columns = slice(top, bottom), slice(left, right)
        return Sight(
            frame.camera.cropped(left, top, right - left, bottom - top),
            _to_8bit(frame.image[rows, columns]),
            _to_8bit(frame.mask[rows, columns]),
        )

    def loss(self, avatar: Avatar, pose: Pose, weights: PictureWeights) -> Tensor:
        """Eq. 2 for a pose of one frame."""
        picture, mask = self.picture.float() / 255, self.mask.float() / 255
        image = render(avatar(pose), self.camera, SPLAT)
        over = image.color + (1 - image.alpha)[..., None] * picture
        loss = (over - picture).abs().mean()
        if weights.alpha:
            loss = loss + weights.alpha * (image.alpha - mask).abs().mean()
        if weights.ssim:
            loss = loss + weights.ssim * (1 - ssim(over, picture))
        return loss * mask.numel() / mask.sum()


def _to_8bit(image: np.ndarray) -> Tensor:
    return torch.from_numpy(np.round(image * 255).astype(np.uint8))


def _box(frame: Frame, points: np.ndarray) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the person's surroundings, pixels."""
    if frame.mask.sum() < SMALLEST:
        raise Hidden("its mask is empty")
    T = frame.camera.T_camera_world
    if (points @ T[2, :3] + T[2, 3]).min() <= 0:
        raise Hidden("its avatar reaches behind the camera")
    pixels = frame.camera.project(points)
    size = np.array([frame.camera.width, frame.camera.height])
    if (pixels.max(0) < 0).any() or (pixels.min(0) > size).any():
        raise Hidden("its avatar is out of view")
    rows, columns = np.nonzero(frame.mask > 0.5 * frame.mask.max())
    low = np.minimum(pixels.min(0), [columns.min(), rows.min()])
    high = np.maximum(pixels.max(0), [columns.max() + 1, rows.max() + 1])
    margin = MARGIN * (high - low).max()
    left, top = np.clip(np.floor(low - margin), 0, size - 1).astype(int)
    right, bottom = np.clip(np.ceil(high + margin), [left + 1, top + 1], size).astype(int)
    if min(right - left, bottom - top) < SMALLEST:
        raise Hidden("it shows too little of the person")
    return int(left), int(top), int(right), int(bottom)
