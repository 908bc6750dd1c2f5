"""The working grid (the pictures' part around the person), and how a hand-held camera moved.

A small turn of a camera moves its picture by nearly an affine map A. From a reference picture R and
a picture I, without the person in either, A minimises

1. ``sum w (r^2 + n^2 |(A - 1) / s|^2)``,   ``r = I(A x) - R(x)`` less its local mean

by Gauss and Newton's steps on shrunk grey pictures, coarse before fine. The derivative J of R is
computed once, and each step is undone in A (inverse compositional, Baker and Matthews 2004):

2. ``A <- A (1 + D)^-1``,   ``D = (J^T w J + P)^-1 (J^T w r + P (A - 1))``

with ``P = sum w n^2 / s^2``. Where the background shows nothing of a part of A, such as a slide
along the edge of the floor, A stays near the identity, by the sizes s of a hand's motions.

Light that moves with the person is no motion of the camera. The local mean takes soft shadows,
vignettes and exposure out, and what is near the person does not count: contact shadows, halos.
The camera stands unless A explains much of the misfit of a camera that stands, and more than the
steps of 8-bit colours. Before a plain wall nothing shows whether a camera moves, or matters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
LOCAL_MEANS = (20.0, 4.0)  # pixels of a shrunk picture, standard deviation of the local mean
CONVERGED_PIXELS = 0.01  # of a shrunk picture: a smaller step ends the iteration
BARE_BELOW = 8  # 8-bit probability of the person below which a pixel shows background
NEAR_PERSON = 0.04  # of the picture's longer side: contact shadows and halos of coding are closer
LEAST_SHARED = 0.2  # share of the picture that has to be background in both pictures
MISFIT_RATIO = 0.6  # the map has to fit better than this times the identity's misfit
LEAST_MISFIT = 0.006  # n, grey in [0, 1]: about an 8-bit step and a half
# s of eq. 1, of half the picture: stretching and turning, and shifts.
USUAL_MOTION = np.array([0.1, 0.1, 1.0, 0.1, 0.1, 1.0])
OUTLIER_GREY = 0.06  # grey in [0, 1]: with a larger difference something moved, and counts less
ALL_BACKGROUND = 0.99  # of a resampled mask in [0, 1]: above it all four neighbours are background


@dataclass(frozen=True)
class ShrunkPicture:
    """A picture at the sizes :data:`LONGER_SIDES`."""

    grey: list[np.ndarray]  # (h, w) float32 in [0, 1]
    bare: list[np.ndarray]  # (h, w) float32, 1 where the person is not, and not near

    @staticmethod
    def of(image: np.ndarray, probability: np.ndarray) -> ShrunkPicture:
        """Shrink a picture (H, W, 3) and the person's probability (H, W), both 8-bit."""
        from PIL import Image
        from scipy.ndimage import distance_transform_edt

        grey, bare = [], []
        for side in LONGER_SIDES:
            scale = min(1.0, side / max(image.shape[:2]))
            size = [max(8, round(n * scale)) for n in image.shape[1::-1]]
            small, P = (
                np.asarray(Image.fromarray(x).resize(size, Image.Resampling.BILINEAR))
                for x in (np.ascontiguousarray(image), np.ascontiguousarray(probability))
            )
            away = P < BARE_BELOW
            if not away.all():
                away = distance_transform_edt(away) > NEAR_PERSON * max(size)
            grey.append(small.mean(-1, dtype=np.float32) / 255)
            bare.append(away.astype(np.float32))
        return ShrunkPicture(grey, bare)


def camera_motions(
    shrunk: Callable[[int], ShrunkPicture], numbers: Sequence[int]
) -> dict[int, np.ndarray | None]:
    """Return the motion from the middle picture to each, by its number.

    Each starts from its neighbour's, because a camera moves steadily.
    """
    middle, found = len(numbers) // 2, {}
    reference = shrunk(numbers[middle])
    for run in (numbers[middle:], numbers[:middle][::-1]):
        last = np.eye(3)
        for k in run:
            found[k] = camera_motion(reference, shrunk(k), last)
            last = last if found[k] is None else found[k]
    return found


def moved_pixels(A: np.ndarray, size: tuple[int, int]) -> float:
    """Return how far A moves the corners of a picture of a size (W, H), pixels."""
    corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)])
    return float(np.abs((corners @ A.T - corners)[:, :2] * size).max() / 2)


def camera_motion(
    reference: ShrunkPicture, picture: ShrunkPicture, start: np.ndarray
) -> np.ndarray | None:
    """Return A (3, 3), eq. 1, starting at ``start``; None if too little background is shared.

    Coordinates are shares of the picture's width and height, from -1 to 1.
    """
    A, identity = start, np.eye(3)
    for level, steps in enumerate(STEPS_PER_SIZE):
        R, bare = reference.grey[level], reference.bare[level]
        h, w = R.shape
        y, x = np.mgrid[:h, :w].astype(np.float32)
        x, y = (2 * x + 1) / w - 1, (2 * y + 1) / h - 1
        gy, gx = np.gradient(R)
        gx, gy = gx * w / 2, gy * h / 2
        J = (gx * x, gx * y, gx, gy * x, gy * y, gy)
        J = np.stack([_fine(column, bare, level).ravel() for column in J], -1)
        both = np.stack([picture.grey[level], picture.bare[level]], -1)
        for _ in range(steps):
            seen = moved(both, A, outside=0)
            weight = bare * (seen[..., 1] > ALL_BACKGROUND)
            if weight.mean() < LEAST_SHARED:  # lost, if there is anything to find
                lost = _misfits(reference, picture, identity)[0] > 2 * LEAST_MISFIT**2
                return None if lost else identity
            rest = _fine(seen[..., 0] - R, weight, level)
            weight = (weight / (1 + (rest / OUTLIER_GREY) ** 2)).ravel()
            JW = J.T * weight
            P = weight.sum() * (LEAST_MISFIT / USUAL_MOTION) ** 2
            away = (A - identity)[:2].ravel()
            step = np.linalg.solve(JW @ J + np.diag(P), JW @ rest.ravel() + P * away)
            A = A @ np.linalg.inv(identity + np.vstack([step.reshape(2, 3), np.zeros(3)]))
            if np.abs(step).max() < 2 * CONVERGED_PIXELS / max(h, w):
                break
    moves, stands = _misfits(reference, picture, A)
    return A if moves < MISFIT_RATIO * stands else identity


def _fine(values: np.ndarray, bare: np.ndarray, level: int) -> np.ndarray:
    """Return values (h, w) less their local mean over bare pixels (h, w); zero elsewhere."""
    from scipy.ndimage import gaussian_filter

    mean, weight = (gaussian_filter(x, LOCAL_MEANS[level]) for x in (values * bare, bare))
    return (values - mean / weight.clip(1e-6)) * bare


def _misfits(
    reference: ShrunkPicture, picture: ShrunkPicture, A: np.ndarray
) -> tuple[float, float]:
    """Return the mean squares of eq. 1's r for A and for a camera that stands.

    Both are over the same pixels, and cut off at :data:`OUTLIER_GREY`. The square of
    :data:`LEAST_MISFIT` is added: less is not to be explained.
    """
    both = np.stack([picture.grey[-1], picture.bare[-1]], -1)
    seen = moved(both, A, outside=0)
    shared = reference.bare[-1] * picture.bare[-1] * (seen[..., 1] > ALL_BACKGROUND)
    rest = (_fine(x[..., 0] - reference.grey[-1], shared, -1) for x in (seen, both))
    moves, stands = (float(np.minimum(x**2, OUTLIER_GREY**2).sum()) for x in rest)
    count, least = max(1.0, float(shared.sum())), LEAST_MISFIT**2
    return moves / count + least, stands / count + least


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
