"""The working grid (the pictures' part around the person), and how a hand-held camera moved.

A small turn of a camera moves its picture by nearly an affine map A. From a reference picture R and
a picture I, without the person in either, A minimises

1. ``sum w (I(A x) - R(x) - mean)^2``

by Gauss and Newton's steps on shrunk grey pictures, coarse before fine. The derivative J of R is
computed once, and each step is undone in A (inverse compositional, Baker and Matthews 2004):

2. ``A <- A (1 + D)^-1``,   ``D = (J^T w J)^-1 J^T w (I(A x) - R - mean)``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

GRID_SIDE = 720  # pixels of the person's longer side on the grid. Chosen: more shows no more
GRID_MARGIN = 0.12  # of the person's longer side, around it. Chosen: networks miss hands and hair


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
        border = np.ceil(GRID_MARGIN * longer.max())
        low = np.maximum(extents[:, :2].min(0) - border, 0).astype(int)
        high = np.minimum(extents[:, 2:].max(0) + border, picture[::-1]).astype(int)
        scale = min(1.0, GRID_SIDE / float(np.median(longer)))
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
        """Resample an image (H, W) or (H, W, C) 8-bit of the whole picture to the grid."""
        from PIL import Image

        left, top, right, bottom = self.box
        if self.size == (bottom - top, right - left):
            return np.ascontiguousarray(image[top:bottom, left:right])
        part = Image.fromarray(np.ascontiguousarray(image[top:bottom, left:right]))
        return np.asarray(part.resize(self.size[::-1], Image.Resampling.BILINEAR))

    def paste(self, mask: np.ndarray) -> np.ndarray:
        """Resample a mask (h, w) of the grid, in [0, 1], to the whole picture (H, W), 8-bit."""
        from PIL import Image

        left, top, right, bottom = self.box
        part = Image.fromarray(np.round(mask * 255).astype(np.uint8))
        if self.size != (bottom - top, right - left):
            part = part.resize((right - left, bottom - top), Image.Resampling.BICUBIC)
        whole = np.zeros(self.picture, np.uint8)
        whole[top:bottom, left:right] = np.asarray(part)
        return whole


# All chosen.
LONGER_SIDES = (80, 320)  # pixels of the shrunk pictures' longer side: coarse, then fine
STEPS_PER_SIZE = (12, 6)  # at most; the fine picture starts from the coarse one's map
CONVERGED_PIXELS = 0.01  # of a shrunk picture: a smaller step ends the iteration
BARE_BELOW = 8  # 8-bit probability of the person below which a pixel shows background
LEAST_SHARED = 0.2  # share of the picture that has to be background in both pictures
MISFIT_RATIO = 0.6  # the map has to fit better than this times the identity's misfit
OUTLIER_GREY = 0.06  # grey in [0, 1]: with a larger difference something moved, and counts less
ALL_BACKGROUND = 0.99  # of a resampled mask in [0, 1]: above it all four neighbours are background


@dataclass(frozen=True)
class ShrunkPicture:
    """A picture at the sizes :data:`LONGER_SIDES`."""

    grey: list[np.ndarray]  # (h, w) float32 in [0, 1]
    bare: list[np.ndarray]  # (h, w) float32, 1 where the person is not

    @staticmethod
    def of(image: np.ndarray, probability: np.ndarray) -> ShrunkPicture:
        """Shrink a picture (H, W, 3) and the person's probability (H, W), both 8-bit."""
        from PIL import Image

        grey, bare = [], []
        for side in LONGER_SIDES:
            scale = min(1.0, side / max(image.shape[:2]))
            size = [max(8, round(n * scale)) for n in image.shape[1::-1]]
            small, P = (
                np.asarray(Image.fromarray(x).resize(size, Image.Resampling.BILINEAR))
                for x in (np.ascontiguousarray(image), np.ascontiguousarray(probability))
            )
            grey.append(small.mean(-1, dtype=np.float32) / 255)
            bare.append((P < BARE_BELOW).astype(np.float32))
        return ShrunkPicture(grey, bare)


def camera_motion(
    reference: ShrunkPicture, picture: ShrunkPicture, start: np.ndarray
) -> np.ndarray | None:
    """Return A (3, 3), eq. 1, starting at ``start``; None if too little background is shared.

    Coordinates are shares of the picture's width and height, from -1 to 1. The result is the
    identity unless A fits clearly better, because a bare wall hardly constrains A.
    """
    A = start
    for level, steps in enumerate(STEPS_PER_SIZE):
        R, bare = reference.grey[level], reference.bare[level]
        h, w = R.shape
        y, x = np.mgrid[:h, :w].astype(np.float32)
        x, y = (2 * x + 1) / w - 1, (2 * y + 1) / h - 1
        gy, gx = np.gradient(R)
        gx, gy = gx * w / 2, gy * h / 2
        J = np.stack([gx * x, gx * y, gx, gy * x, gy * y, gy], -1).reshape(-1, 6)
        both = np.stack([picture.grey[level], picture.bare[level]], -1)
        for _ in range(steps):
            seen = moved(both, A, outside=0)
            weight = bare * (seen[..., 1] > ALL_BACKGROUND)
            if weight.mean() < LEAST_SHARED:
                return None
            rest = seen[..., 0] - R
            rest = rest - np.median(rest[weight > 0])
            weight = (weight / (1 + (rest / OUTLIER_GREY) ** 2)).ravel()
            JW = J.T * weight
            step = np.linalg.solve(JW @ J + 1e-6 * np.eye(6), JW @ rest.ravel())
            A = A @ np.linalg.inv(np.eye(3) + np.vstack([step.reshape(2, 3), np.zeros(3)]))
            if np.abs(step).max() < 2 * CONVERGED_PIXELS / max(h, w):
                break
    bent = _misfit(reference, picture, A)
    return A if bent < MISFIT_RATIO * _misfit(reference, picture, np.eye(3)) else np.eye(3)


def _misfit(reference: ShrunkPicture, picture: ShrunkPicture, A: np.ndarray) -> float:
    """Return the mean square of eq. 1's differences, each cut off at :data:`OUTLIER_GREY`."""
    seen = moved(np.stack([picture.grey[-1], picture.bare[-1]], -1), A, outside=0)
    both = (reference.bare[-1] > 0) & (seen[..., 1] > ALL_BACKGROUND)
    rest = (seen[..., 0] - reference.grey[-1])[both]
    if not both.any():
        return 1.0
    return float(np.minimum((rest - np.median(rest)) ** 2, OUTLIER_GREY**2).mean())


def moved(image: np.ndarray, A: np.ndarray, outside: float | None = None) -> np.ndarray:
    """Return ``image(A x)`` (h, w, C) float32 of an image (h, w, C), bilinear.

    A (3, 3) is in shares of the image's size, from -1 to 1. Beyond its border the image continues
    as its nearest pixel, or has the value ``outside``, which may be 0 alone.
    """
    grid = torch.nn.functional.affine_grid(
        torch.from_numpy(A[None, :2].astype(np.float32)), [1, 1, *image.shape[:2]], False
    )
    whole = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None]
    mode = "border" if outside is None else "zeros"
    found = torch.nn.functional.grid_sample(whole, grid, padding_mode=mode, align_corners=False)
    return found[0].permute(1, 2, 0).numpy()
