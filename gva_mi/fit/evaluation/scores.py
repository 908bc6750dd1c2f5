"""How close one render comes to its target: PSNR, SSIM, LPIPS and ``rand_vgg`` of two pictures.

* PSNR is limited to what rounding to 8 bits allows, :data:`PSNR_MAX`, which equal pictures reach;
* SSIM is that of Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, population covariance;
* LPIPS and ``rand_vgg`` are distances in the features of a network, :mod:`gva_mi.fit.perceptual`.
  Of a picture below 64 pixels the deepest layers would see nothing but the border: there each
  pixel is repeated until both sides have as many.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

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
NETWORK_SIDE = 64  # pixels, the smallest side that the networks are shown


@dataclass(frozen=True)
class ImageScores:
    """How close one render comes to its target."""

    psnr: float  # dB, more is better
    ssim: float  # at most 1, more is better
    lpips: float  # less is better; NaN without the user's weights
    rand_vgg: float  # less is better; comparable only with itself


class Scorer:
    """Scores a render against its target, with the networks of the metrics loaded once."""

    def __init__(self, weights: Weights | None = None) -> None:
        """Load the networks.

        Args:
            weights: for LPIPS; None: those that :func:`gva_mi.fit.perceptual.find_weights` finds.
        """
        self._weights = find_weights() if weights is None else weights
        self.rand_vgg = rand_vgg()
        self.lpips: FeatureMetric | None = lpips(self._weights)

    def __call__(self, render: np.ndarray, target: np.ndarray) -> ImageScores:
        """The scores of two 8-bit images (H, W, 3), both sides at least 11 pixels."""
        times = -(-NETWORK_SIDE // min(render.shape[:2]))
        enlarged = (x.repeat(times, 0).repeat(times, 1) for x in (render, target))
        a, b = (torch.from_numpy(x.astype(np.float32) / 255) for x in enlarged)
        return ImageScores(
            psnr(render, target),
            ssim(render, target),
            np.nan if self.lpips is None else float(self.lpips(a, b)),
            float(self.rand_vgg(a, b)),
        )

    def networks(self) -> dict[str, Any]:
        """Network and weights behind each perceptual figure; None for LPIPS without weights."""
        found, name = self._weights, self._weights.lpips_network
        files = {
            "AlexNet": (found.alexnet, found.lpips_alex),
            "VGG16": (found.vgg16, found.lpips_vgg),
            None: (),
        }[name]
        digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
        return {
            "lpips": {"network": name, "sha256": digests} if name else None,
            "rand_vgg": {
                "network": f"VGG16's layers, {RAND_WIDTH:g} of its channels",
                "weights": f"random, seed {RAND_SEED}",
            },
        }


def psnr(render: np.ndarray, target: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two 8-bit images, dB, at most :data:`PSNR_MAX`."""
    from skimage.metrics import mean_squared_error, peak_signal_noise_ratio

    if mean_squared_error(render, target) == 0:
        return PSNR_MAX
    return min(PSNR_MAX, float(peak_signal_noise_ratio(target, render)))


def ssim(render: np.ndarray, target: np.ndarray) -> float:
    """Structural similarity of two 8-bit images (H, W, 3), both sides at least 11 pixels."""
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            target,
            render,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )
