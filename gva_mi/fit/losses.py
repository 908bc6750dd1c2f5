"""The loss of an avatar's fit: Eq. 9 of the paper, and two optional terms of other codes.

    L_render = |C - I| + λ3 |VGG(C) - VGG(I)| + λ4 |MLP(θ)|                                    (9)

    + λ_alpha |A - S| + λ_ssim (1 - SSIM(C, I))                                        (optional)

=============  ==================  ========  =============================================
symbol         code name           unit      meaning
=============  ==================  ========  =============================================
C (H, W, 3)    ``image.color``     [0, 1]    the render, on a background
I (H, W, 3)    ``target``          [0, 1]    the person on the same background
A (H, W)       ``image.alpha``     [0, 1]    how much of the background the avatar covers
S (H, W)       ``mask``            [0, 1]    the person's mask
MLP(θ) (N, 3)  ``residual``        m         the pose-conditioned shift of the Gaussians
=============  ==================  ========  =============================================

Every ``|·|`` is a mean of absolute values, so weights depend neither on the number of Gaussians nor
on the size of the picture: sums over pixels are divided by the area of the person's box, including
differences outside of it. A person in a large room counts as much as one who fills the picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from gva_mi.core.options import Weight, options_of
from gva_mi.fit.ssim import ssim
from gva_mi.splat import Image

if TYPE_CHECKING:
    from gva_mi.fit.samples import SampleTarget

Distance = Callable[[Tensor, Tensor], Tensor]  # of two images (H, W, 3)


@options_of("fit")
class LossOptions:
    """Weights of the terms; the reconstruction term has weight 1. The defaults are the paper's."""

    perceptual: Weight = 0.1  # λ3, of the features' difference
    residual: Weight = 0.5  # λ4, per metre, of the pose-conditioned residual
    alpha: Weight = 0.0  # λ_alpha, of the render's alpha against the mask; other codes use 0.1
    ssim: Weight = 0.0  # λ_ssim, of 1 - SSIM; other codes use 0.01 to 0.2


@dataclass(frozen=True)
class Losses:
    """The terms of one step, scalars before their weights; a term of weight 0 is left at 0."""

    recon: Tensor  # |C - I|
    perceptual: Tensor  # |VGG(C) - VGG(I)|
    residual: Tensor  # |MLP(θ)|, metres
    alpha: Tensor  # |A - S|
    ssim: Tensor  # 1 - SSIM(C, I)

    def total(self, options: LossOptions, perceptual_every: int = 1) -> Tensor:
        """Return the weighted sum, Eq. 9; steps between two perceptual terms are made up for."""
        weights = asdict(options)
        weights["perceptual"] *= perceptual_every
        return self.recon + sum(weight * getattr(self, name) for name, weight in weights.items())


def render_losses(
    image: Image, target: SampleTarget, residual: Tensor, options: LossOptions, distance: Distance
) -> Losses:
    """Compute the terms of Eq. 9 for one render.

    Args:
        image: the render on black, color (H, W, 3) and alpha (H, W).
        target: the person, and the render's background. The perceptual and the SSIM term, which
            cost more than the render on the whole image, see its window.
        residual: the residual MLP's shifts, (N, 3) in metres.
        options: a term of weight 0 is left out.
        distance: ``|VGG(C) - VGG(I)|``, see :mod:`gva_mi.fit.perceptual`.

    Returns:
        The terms, each a scalar.
    """
    zero = torch.zeros((), dtype=residual.dtype)
    perceptual = similarity = alpha = zero
    if options.perceptual or options.ssim:
        seen = target.in_window(image)
        perceptual = distance(*seen) if options.perceptual else zero
        similarity = 1 - ssim(*seen) if options.ssim else zero
    if options.alpha:
        alpha = (image.alpha - target.composite()[2]).abs().sum() / target.area
    shift = residual.abs().mean() if options.residual and residual.numel() else zero
    return Losses(target.error(image), perceptual, shift, alpha, similarity)
