"""What a frame says about the body: mask and normals, at the size they are compared (Eq. 9).

Everything is divided by the person's area in pixels, so that a weight means the same for a person
who fills the picture and one who stands far away, and for any resolution:

    L_normal = Σ_pixels |N - N_pred|_1 / 3 / area,        L_silhouette = Σ_pixels |S - S_pred| /
    area
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.data.video import Frame
from gva_mi.splat import Camera

MARGIN = 0.15  # of the box around the person, added on each side
SMALLEST = 16.0  # pixels: a smaller mask is taken for an empty one


class CannotRefine(Exception):
    """Why a frame keeps its stage-1 pose; nothing stops for it."""


@dataclass(frozen=True)
class Target:
    """The evidence of one frame, cut to the person's surroundings."""

    camera: Camera  # of the part that was cut out
    mask: Tensor  # (H, W) in [0, 1]
    normals: Tensor | None  # (H, W, 3) unit, zero outside the mask
    area: float  # of the person, pixels

    @staticmethod
    def of(frame: Frame, size: int, points: Tensor) -> Target:
        """Shrink a frame and cut it to a box around its mask and the body's stage-1 vertices.

        Args:
            frame: as the video gives it.
            size: pixels of the frame's longer side after shrinking; a smaller frame stays as it is.
            points: (V, 3) world, the body in its stage-1 pose.

        Raises:
            CannotRefine: the mask is empty, or the body is not seen by the camera.
        """
        height, width = frame.mask.shape
        scale = min(1.0, size / max(height, width))
        shape = (max(1, round(height * scale)), max(1, round(width * scale)))
        camera = frame.camera.resized(shape[1], shape[0])
        mask = _shrink(frame.mask[..., None], shape)[..., 0]
        area = float(mask.sum())
        if area < SMALLEST:
            raise CannotRefine("its mask is empty")
        left, top, right, bottom = _box(mask, camera, points.numpy().astype(np.float64))
        camera = camera.cropped(left, top, right - left, bottom - top)
        normals = None
        if frame.normals is not None:
            # Means of unit vectors are shorter: made unit again, and cut where the mask has less
            # than a half.
            normals = torch.nn.functional.normalize(_shrink(frame.normals, shape), dim=-1)
            normals = (normals * (mask > 0.5)[..., None])[top:bottom, left:right].contiguous()
        return Target(camera, mask[top:bottom, left:right].contiguous(), normals, area)

    def normal_loss(self, image: Tensor) -> Tensor:
        """L_normal of a rendering (H, W, 4); zero where the frame has no normals."""
        if self.normals is None:
            return image.new_zeros(())
        # A pixel inside the mask without a normal, beyond the edge of a crop, says nothing.
        told = self.normals.any(-1) | (self.mask <= 0.5)
        return ((image[..., :3] - self.normals).abs() * told[..., None]).sum() / (3 * self.area)

    def silhouette_loss(self, image: Tensor) -> Tensor:
        """L_silhouette of a rendering (H, W, 4)."""
        return (image[..., 3] - self.mask).abs().sum() / self.area


def _shrink(image: np.ndarray, shape: tuple[int, int]) -> Tensor:
    """Means over areas: (H, W, C) float32 to ``shape``."""
    stacked = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None]
    if stacked.shape[2:] == shape:
        return stacked[0].permute(1, 2, 0)
    return torch.nn.functional.interpolate(stacked, size=shape, mode="area")[0].permute(1, 2, 0)


def _box(mask: Tensor, camera: Camera, points: np.ndarray) -> tuple[int, int, int, int]:
    """Left, top, right, bottom in pixels."""
    depth = points @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
    if depth.min() <= 0:
        raise CannotRefine("its stage-1 body reaches behind the camera")
    pixels = camera.project(points)
    size = np.array([camera.width, camera.height])
    if (pixels.max(0) < 0).any() or (pixels.min(0) > size).any():
        raise CannotRefine("its stage-1 body is out of view")
    rows, columns = np.nonzero(mask.numpy() > 0.5 * float(mask.max()))
    low = np.minimum(pixels.min(0), [columns.min(), rows.min()])
    high = np.maximum(pixels.max(0), [columns.max() + 1, rows.max() + 1])
    margin = MARGIN * (high - low).max()
    left, top = np.clip(np.floor(low - margin), 0, size - 1).astype(int)
    right, bottom = np.clip(np.ceil(high + margin), [left + 1, top + 1], size).astype(int)
    return int(left), int(top), int(right), int(bottom)
