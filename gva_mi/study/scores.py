"""Metrics of one render against its target: PSNR, SSIM, LPIPS and ``rand_vgg``.

* PSNR is limited to what rounding to 8 bits allows, :data:`PSNR_MAX`, which equal pictures reach;
* SSIM is that of Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, population covariance;
* LPIPS and ``rand_vgg`` are distances between features of a network, :mod:`gva_mi.fit.perceptual`.
  The deepest layers would see only the border of a picture below 64 pixels: there each pixel is
  repeated until both sides are long enough. Of one beyond 1024 pixels they see means over squares,
  because they take most of the time.

Most of a picture is background, where a render equals its target, and so do features that do not
see the person. So only the part around the person is looked at; the rest counts as equal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.tasks import on_all_cores
from gva_mi.data.crop import block_means, bounds
from gva_mi.fit.perceptual import (
    RAND_SEED,
    RAND_WIDTH,
    FeatureMetric,
    Weights,
    find_weights,
    lpips,
    rand_vgg,
)

# The PSNR of rounding to 8 bits, an error with a variance of 1/12 of a level squared: 58.9 dB.
PSNR_MAX = float(20 * np.log10(255) + 10 * np.log10(12))
NETWORK_SIDE = 64  # pixels, the smallest side that the networks see
NETWORK_LONGEST = 1024  # pixels, the largest side that they see
# Pixels from which their deepest features see something, and between the positions of these.
NETWORK_SIGHT, NETWORK_STEP = 98, 16
SSIM_RADIUS = 5  # pixels, of its window
_SSIM = {
    "channel_axis": -1, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False,
}  # fmt: skip


class ImageScores(NamedTuple):
    """Scores of one render against its target."""

    psnr: float  # dB, more is better
    ssim: float  # at most 1, more is better
    lpips: float  # less is better; NaN without the user's weights
    rand_vgg: float  # less is better; comparable only with itself


def mean_scores(scores: Sequence[ImageScores]) -> list[float | None]:
    """Average each score of :class:`ImageScores`; None where it is not known."""
    return [None if np.isnan(x) else x for x in np.mean(scores, axis=0).tolist()]


class Scorer:
    """Scores renders with the networks of the metrics, which are loaded once."""

    def __init__(self, weights: Weights | None = None) -> None:
        """Load the networks; ``weights`` for LPIPS, None: those that ``find_weights`` finds."""
        self._weights = find_weights() if weights is None else weights
        self.rand_vgg = rand_vgg()
        self.lpips: FeatureMetric | None = lpips(self._weights)

    def __call__(self, render: np.ndarray, target: np.ndarray) -> ImageScores:
        """Score two 8-bit images (H, W, 3), both sides at least 11 pixels."""
        (a, b), size = _for_networks(render, target)
        return ImageScores(
            psnr(render, target),
            ssim(render, target),
            np.nan if self.lpips is None else float(self.lpips(a, b, size)),
            float(self.rand_vgg(a, b, size)),
        )

    def of_pairs(self, pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> list[ImageScores]:
        """Score renders and targets on all cores; any number of them gives the same bits."""
        with one_torch_thread():
            return list(on_all_cores(lambda pair: self(*pair), pairs))

    def networks(self) -> dict[str, Any]:
        """Describe network and weights of each perceptual metric; None for LPIPS without any."""
        files = self._weights.of_lpips
        digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
        return {
            "lpips": {"network": "VGG16", "sha256": digests} if files else None,
            "rand_vgg": {
                "network": f"VGG16's layers, {RAND_WIDTH:g} of its channels",
                "weights": f"random, seed {RAND_SEED}",
            },
        }


def _where_they_differ(
    render: np.ndarray, target: np.ndarray, border: int, step: int = 1
) -> tuple[slice, slice]:
    """Return rows and columns of the pixels that differ, with a border, in whole steps."""
    R, G, B = np.moveaxis(render != target, -1, 0)
    found = bounds(R | G | B)
    left, top, right, bottom = (0, 0, 1, 1) if found is None else found.astype(int).tolist()
    steps = lambda low, high: (max(0, low - border) // step, -(-(high + border) // step))
    wide = lambda low, high: slice(*(step * x for x in steps(low, high)))
    return wide(top, bottom), wide(left, right)


def _for_networks(
    render: np.ndarray, target: np.ndarray
) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
    """Return what the networks see of two 8-bit images (H, W, 3), float32, 0 to 1.

    That is the part that :data:`NETWORK_SIGHT` needs of them. Also the size (H', W') that the whole
    pictures would have.
    """
    least, most = min(render.shape[:2]), max(render.shape[:2])
    times = -(-NETWORK_SIDE // least)
    by = max(1, min(-(-most // NETWORK_LONGEST), least // NETWORK_SIDE))
    rows, columns = (side // by * by for side in render.shape[:2])
    both = [x[:rows, :columns] for x in (render, target)]
    if times == 1:
        part = _where_they_differ(*both, by * NETWORK_SIGHT, by * NETWORK_STEP)
        both = [x[part] for x in both]
    seen = []
    for image in both:
        image = image.repeat(times, 0).repeat(times, 1).astype(np.float32)
        seen.append(torch.from_numpy(block_means(image, by) / np.float32(255)))
    return (seen[0], seen[1]), (rows * times // by, columns * times // by)


def psnr(render: np.ndarray, target: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio of two 8-bit images, dB, at most :data:`PSNR_MAX`."""
    part = _where_they_differ(render, target, 0)
    away = render[part].astype(np.float64) - target[part]
    error = float(np.square(away).sum()) / render.size
    return psnr_of(error)


def psnr_of(error: float) -> float:
    """Return the PSNR of a mean squared error in levels of 8 bits, dB."""
    return PSNR_MAX if error == 0 else min(PSNR_MAX, float(10 * np.log10(255**2 / error)))


def ssim(render: np.ndarray, target: np.ndarray) -> float:
    """Return the structural similarity of two 8-bit images (H, W, 3), sides at least 11 pixels.

    It is 1 where the pictures are equal, so only the rest is computed.
    """
    from skimage.metrics import structural_similarity

    r = SSIM_RADIUS
    render_, target_ = (x[_where_they_differ(render, target, 2 * r)] for x in (render, target))
    lacking = 1 - structural_similarity(target_, render_, full=True, **_SSIM)[1][r:-r, r:-r]
    height, width = (side - 2 * r for side in render.shape[:2])
    return 1 - float(lacking.sum()) / (3 * height * width)


def ssim_map(render: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the structural similarity around each pixel, (H, W), the mean over the colours."""
    from skimage.metrics import structural_similarity

    return structural_similarity(target, render, full=True, **_SSIM)[1].mean(2)
