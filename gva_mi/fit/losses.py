"""The loss of an avatar's fit: Eq. 9 of the paper, and two optional terms.

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
from torch.autograd.function import FunctionCtx

from gva_mi.core.options import PythonOnly, Weight, options_of
from gva_mi.splat import Image

if TYPE_CHECKING:
    from gva_mi.fit.samples import SampleTarget

SSIM_SIDE, SSIM_SIGMA = 11, 1.5  # pixels, of the window of Wang et al. (2004)
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # of Wang et al. (2004), for values in [0, 1]

Distance = Callable[[Tensor, Tensor], Tensor]  # of two images (H, W, 3)


@options_of("fit")
class LossOptions:
    """Weights of the terms; the reconstruction term has weight 1. The defaults are the paper's."""

    perceptual: PythonOnly[Weight] = 0.1  # λ3, of the features' difference
    residual: PythonOnly[Weight] = 0.5  # λ4, per metre, of the pose-conditioned residual
    alpha: Weight = 0.0  # λ_alpha, of the render's alpha against the mask; other programs use 0.1
    ssim: PythonOnly[Weight] = 0.0  # λ_ssim, of 1 - SSIM; other programs use 0.01 to 0.2


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
    perceptual = similarity = zero
    if options.perceptual or options.ssim:
        seen = target.in_window(image)
        perceptual = distance(*seen) if options.perceptual else zero
        similarity = 1 - ssim(*seen) if options.ssim else zero
    shift = residual.abs().mean() if options.residual and residual.numel() else zero
    recon, alpha = target.errors(image)
    return Losses(recon, perceptual, shift, alpha if options.alpha else zero, similarity)


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Return the structural similarity of two images (H, W, C) in [0, 1], a scalar.

    With means a, b, u, v, w of x, y, x², y², x y over a Gaussian window inside the image, it is the
    mean of L K over pixels and channels, where

        L = (2 a b + C1) / (a² + b² + C1),    K = (2 (w - a b) + C2) / (u - a² + v - b² + C2)

    Differentiable in ``image``; ``target`` is constant. Both sides must be at least 11 pixels.
    """
    if min(image.shape[:2]) < SSIM_SIDE:
        raise ValueError(f"ssim(): images must be at least 11 x 11, got {tuple(image.shape[:2])}")
    off = torch.arange(SSIM_SIDE, dtype=image.dtype) - SSIM_SIDE // 2
    window = torch.exp(-0.5 * (off / SSIM_SIGMA) ** 2)
    weights = (window / window.sum()).tolist()
    along = lambda axis, x: _WindowMeans.apply(x, weights, axis)
    means = lambda *maps: along(-2, along(-1, torch.stack(maps)))
    x, y = image.movedim(2, 0), target.detach().movedim(2, 0)
    (a, u, w), (b, v) = means(x, x * x, x * y), means(y, y * y)
    L = (2 * a * b + SSIM_C1) / (a * a + b * b + SSIM_C1)
    K = (2 * (w - a * b) + SSIM_C2) / (u - a * a + v - b * b + SSIM_C2)
    return (L * K).mean()


class _WindowMeans(torch.autograd.Function):
    """Weighted means over a sliding window along one axis, ``y_i = Σ_k w_k x_(i+k)``.

    They have the bits of torch's ``conv2d``, whose code for a single channel takes five times as
    long or more. So do gradients, whose products are rounded before they are added along rows, and
    not along columns.
    """

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, weights: list[float], axis: int) -> Tensor:
        ctx.weights, ctx.axis = weights, axis
        return _window_means(x, weights, axis)

    @staticmethod
    def jvp(ctx: FunctionCtx, x: Tensor, *_: None) -> Tensor:
        return _window_means(x, ctx.weights, ctx.axis)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None, None]:
        axis, shape = ctx.axis, list(grad.shape)
        count, shape[axis] = shape[axis], shape[axis] + len(ctx.weights) - 1
        total = grad.new_zeros(shape)
        for k, weight in enumerate(ctx.weights):
            part = total.narrow(axis, k, count)
            part.add_(grad * weight) if axis == -1 else part.add_(grad, alpha=weight)
        return total, None, None


def _window_means(x: Tensor, weights: list[float], axis: int) -> Tensor:
    count = x.shape[axis] - len(weights) + 1
    total = x.narrow(axis, 0, count) * weights[0]
    for k, weight in enumerate(weights[1:], 1):
        total.add_(x.narrow(axis, k, count), alpha=weight)  # rounded once
    return total
