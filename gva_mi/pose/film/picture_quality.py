"""How good the pictures of a film are: light, sharpness, and whether the camera stands still.

Sharpness is measured by blurring again, as of Crete et al., "The blur effect" (2007): a Gaussian
blur G takes away most gradients of a sharp picture I, and few of a picture that is blurred already,

    1. b = max over x and y of  Σ |∂ (G I)|² / Σ |∂ I|²       over the person's pixels

so that b depends little on what is in the picture. The larger of both directions shows the motion
blur of a hand or of the camera.

The camera's motion is the displacement s that makes the background of two pictures most alike,

    2. s = argmin over s of  mean |I(x) − I'(x + s)|         over pixels x outside both persons

and zero unless that is better than no displacement by a good part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gva_mi.core.console import Progress
from gva_mi.data.splits import spread
from gva_mi.data.video import Frame, Video

SHOWN = 24  # frames that are looked at
TALL = 400  # pixels: a taller person is measured at this height, so that fine detail is no matter
AGAIN = 1.0  # pixels, standard deviation of G
WIDE = 240  # pixels, width at which the camera's motion is measured
FARTHEST = 8  # such pixels of displacement that are tried
GAIN = 0.4  # share of the difference that a displacement has to explain
NOISE = 0.008  # difference of pictures that noise and compression make
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True)
class PictureQuality:
    """Figures of some frames of a film."""

    frames: Sequence[int]  # those looked at
    light: np.ndarray  # (n,) 90th percentile of the person's luma, in [0, 1]
    blur: np.ndarray  # (n,) eq. 1, in [0, 1]
    drift: float  # largest displacement from the first of them (eq. 2), share of the width

    @staticmethod
    def of(video: Video, progress: Progress | None = None) -> PictureQuality:
        """Look at up to :data:`SHOWN` frames of a film."""
        frames = spread([k for k in range(len(video)) if k not in video.absent], SHOWN)
        light, blur, small = [], [], []
        for done, frame in enumerate(video.frames(frames), 1):
            luma = frame.image @ LUMA
            light.append(float(np.quantile(luma[frame.mask > 0.5], 0.9)))
            blur.append(_blur(luma, frame.mask))
            small.append(_small(frame))
            if progress:
                progress(done, len(frames))
        drift = max((_displacement(small[0], other) for other in small[1:]), default=0.0)
        return PictureQuality(frames, np.array(light), np.array(blur), drift)


def _blur(luma: np.ndarray, mask: np.ndarray) -> float:
    """Return eq. 1 of a person (H, W); 0 if there are too few pixels."""
    from scipy.ndimage import gaussian_filter

    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    luma, mask = luma[box], mask[box]
    if len(luma) > TALL:
        size = max(1, luma.shape[1] * TALL // len(luma)), TALL
        luma, mask = _shrunk(luma, size), _shrunk(mask, size)
    again, found = gaussian_filter(luma, AGAIN), []
    for axis, neighbours in enumerate([(mask[1:], mask[:-1]), (mask[:, 1:], mask[:, :-1])]):
        inside = np.minimum(*neighbours)
        before, after = (
            np.square(np.diff(x, axis=axis))[inside > 0.9].sum() for x in (luma, again)
        )
        found.append(after / before if before > 0 else 0.0)
    return float(max(found))


def _small(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame's luma at width WIDE, and where its background is, away from the person."""
    from scipy.ndimage import maximum_filter

    height, width = frame.mask.shape
    size = WIDE, max(1, height * WIDE // width)
    beside = maximum_filter(_shrunk(frame.mask, size), 9) < 0.02
    return _shrunk(frame.image @ LUMA, size), beside


def _shrunk(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return an image (H, W) at another width and height, by means over areas."""
    from PIL import Image

    return np.asarray(Image.fromarray(image.astype("f4")).resize(size, Image.Resampling.BOX))


def _displacement(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]
) -> float:
    """Return the length of eq. 2 as a share of the width; 0 if none is clearly better than none."""
    edge = FARTHEST
    inner = np.s_[edge:-edge, edge:-edge]
    height, width = one[0].shape
    if min(height, width) < 4 * edge:
        return 0.0
    differences = {}
    for dy in range(-edge, edge + 1):
        for dx in range(-edge, edge + 1):
            moved = np.s_[edge + dy : height - edge + dy, edge + dx : width - edge + dx]
            both = one[1][inner] & other[1][moved]
            if both.any():
                apart = np.abs(one[0][inner] - other[0][moved])[both]
                differences[dx, dy] = float(apart.mean())
    if (0, 0) not in differences:
        return 0.0
    best = min(differences, key=differences.__getitem__)
    if differences[best] > (1 - GAIN) * differences[0, 0] or differences[0, 0] < NOISE:
        return 0.0
    return float(np.hypot(*best)) / WIDE
