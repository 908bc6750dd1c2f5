"""What the avatar's fit minimises: Eq. 9 of the paper, and two optional terms of other codes.

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

Every ``|·|`` is a mean of absolute values: a weight does not depend on the number of Gaussians, nor
on the size of the picture, for the first mean is taken over the person's box. What differs outside
of it, where a Gaussian strays, is added to the sum; but a person in a large room counts no less
than one who fills the picture, and the other terms no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.core.options import Weight, require_ranges
from gva_mi.fit.ssim import ssim
from gva_mi.splat import Image

Window = tuple[slice, slice]  # rows and columns of a part of an image
Distance = Callable[[Tensor, Tensor], Tensor]  # of two images (H, W, 3)


@dataclass(frozen=True)
class LossOptions:
    """Weights of the terms; the reconstruction term has weight 1. The defaults are the paper's."""

    perceptual: Weight = 0.1  # λ3, of the features' difference
    residual: Weight = 0.5  # λ4, per metre, of the pose-conditioned residual
    alpha: Weight = 0.0  # λ_alpha, of the render's alpha against the mask; other codes use 0.1
    ssim: Weight = 0.0  # λ_ssim, of 1 - SSIM; other codes use 0.01 to 0.2

    def __post_init__(self) -> None:
        require_ranges("LossOptions", self)


@dataclass(frozen=True)
class Losses:
    """The terms of one step, scalars before their weights; a term of weight 0 is left at 0."""

    recon: Tensor  # |C - I|
    perceptual: Tensor  # |VGG(C) - VGG(I)|
    residual: Tensor  # |MLP(θ)|, metres
    alpha: Tensor  # |A - S|
    ssim: Tensor  # 1 - SSIM(C, I)

    def total(self, options: LossOptions) -> Tensor:
        """The weighted sum, Eq. 9."""
        weighted = (getattr(options, f.name) * getattr(self, f.name) for f in fields(options))
        return self.recon + sum(weighted)


def render_losses(
    image: Image,
    target: Tensor,
    mask: Tensor,
    residual: Tensor,
    options: LossOptions,
    distance: Distance,
    window: Window = (slice(None), slice(None)),
    area: int | None = None,
) -> Losses:
    """The terms of Eq. 9 for one render.

    Args:
        image: the render, color (H, W, 3) and alpha (H, W).
        target: the person on the render's background, (H, W, 3).
        mask: the person, (H, W) in [0, 1].
        residual: the residual MLP's shifts, (N, 3) in metres.
        options: a term of weight 0 is left out.
        distance: ``|VGG(C) - VGG(I)|``, see :mod:`gva_mi.fit.perceptual`.
        window: the part of the image on which the perceptual and the SSIM term are computed. On
            the whole image they cost more than the render; a random part a step costs little.
        area: pixels of the person's box, which the sums of |C - I| and |A - S| are divided by;
            None: those of the image.

    Returns:
        The terms, each a scalar.
    """
    zero = torch.zeros((), dtype=target.dtype)
    color, seen = image.color[window], target[window]
    share = 1.0 if area is None else mask.numel() / area
    return Losses(
        recon=_MeanDifference.apply(image.color, target) * share,
        perceptual=distance(color, seen) if options.perceptual else zero,
        residual=residual.abs().mean() if options.residual and residual.numel() else zero,
        alpha=(image.alpha - mask).abs().mean() * share if options.alpha else zero,
        ssim=1 - ssim(color, seen) if options.ssim else zero,
    )


class _MeanDifference(torch.autograd.Function):
    """mean |a - b|, differentiable in a; half the time of the same from torch's operations."""

    @staticmethod
    def forward(ctx: FunctionCtx, a: Tensor, b: Tensor) -> Tensor:
        difference = a - b
        ctx.save_for_backward(difference)
        ctx.save_for_forward(difference)
        return difference.abs().mean()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None]:
        (difference,) = ctx.saved_tensors
        return torch.sgn(difference).mul_(grad / difference.numel()), None

    @staticmethod
    def jvp(ctx: FunctionCtx, da: Tensor, _: None) -> Tensor:
        (difference,) = ctx.saved_tensors
        return (torch.sgn(difference) * da).mean()
