"""Structural similarity (SSIM) of two images and its exact gradient, as Dr.Jit kernels.

With m the mean over the separable 11 x 11 Gaussian window of Wang et al. (2004), inside the image:

    1. a = m(x),  b = m(y),  u = m(x²),  v = m(y²),  w = m(x y)
    2. L = (2 a b + C1) / (a² + b² + C1)                          luminance
    3. K = (2 (w - a b) + C2) / (u - a² + v - b² + C2)            contrast and structure
    4. S = mean of L K over pixels and channels

and the adjoint in x, with D1 and D2 the denominators of L and K, and mᵀ the transpose of m:

    5. S_u = -L K / D2,   S_w = 2 L / D2,   S_a = 2 K (b - a L) / D1 + 2 L (a K - b) / D2
    6. dS/dx = mᵀ(S_a) + 2 x mᵀ(S_u) + y mᵀ(S_w)

Products with banded matrices take about three times as long.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import torch
from drjit.llvm import UInt32
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.rowwise import flat_array

SIGMA, RADIUS = 1.5, 5  # pixels: of Wang et al.'s window
SIDE = 2 * RADIUS + 1
C1, C2 = 0.01**2, 0.03**2  # for values in [0, 1]

_weights = np.exp(-0.5 * ((np.arange(SIDE) - RADIUS) / SIGMA) ** 2)
WINDOW = (_weights / _weights.sum()).tolist()

Arrays = list[Any]  # of Dr.Jit, flat


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Return the SSIM of two images (H, W, C) in [0, 1], averaged over pixels and channels.

    The mean is over windows inside the image: both sides must be at least 11 pixels.

    Returns:
        A scalar, differentiable in ``image`` both ways; ``target`` is constant.
    """
    if min(image.shape[:2]) < SIDE:
        raise ValueError(f"ssim(): images must be at least 11 x 11, got {tuple(image.shape[:2])}")
    return _Ssim.apply(image, target.detach())


def _size(number: int) -> UInt32:
    """Make a number opaque, or every image size would compile kernels of its own."""
    return dr.opaque(UInt32, number)


def _grid(height: int, width: int) -> tuple[UInt32, UInt32, UInt32]:
    """Return row and column of every lane, and the number of columns."""
    columns, lane = _size(width), dr.arange(UInt32, height * width)
    row = lane // columns
    return row, lane - row * columns, columns


def _window(source: Any, index: UInt32, step: UInt32 | int) -> Arrays:  # noqa: ANN401
    """Read the numbers of a window that begins at ``index``."""
    F = type(source)
    return [dr.gather(F, source, index + k * step) for k in range(SIDE)]


def _weighted(values: Arrays) -> Any:  # noqa: ANN401
    return sum(g * value for g, value in zip(WINDOW, values, strict=True))


def _spread(
    source: Any,  # noqa: ANN401
    place: UInt32,
    last: UInt32,
    index: UInt32,
    step: UInt32 | int,
) -> Any:  # noqa: ANN401
    """Apply mᵀ along one axis: sum over the windows that contain a number, with their weights.

    ``source`` has the numbers of the windows by their start, ``place`` is where the number lies on
    the axis, ``last`` the start of the last window; ``index`` and ``step`` find windows in the
    source.
    """
    F, total = type(source), 0
    for k, g in enumerate(WINDOW):
        inside = (place >= k) & (place <= last + k)
        total = total + g * dr.gather(F, source, index - k * step, active=inside)
    return total


def _moments(x: Any, y: Any, height: int, width: int, channels: int) -> Arrays:  # noqa: ANN401
    """Evaluate eq. 1 along rows."""
    row, at, _ = _grid(height, (width - SIDE + 1) * channels)
    index = row * _size(width * channels) + at
    x, y = (_window(source, index, channels) for source in (x, y))
    times = lambda p, q: [a * b for a, b in zip(p, q, strict=True)]
    return [_weighted(values) for values in (x, y, times(x, x), times(y, y), times(x, y))]


def _similarity(moments: Arrays, height: int, width: int) -> tuple[Any, Arrays]:
    """Evaluate eq. 1 along columns, then L K of eq. 2 to 4 and its derivatives (eq. 5)."""
    row, at, columns = _grid(height - SIDE + 1, width)
    first = row * columns + at
    a, b, u, v, w = (_weighted(_window(source, first, columns)) for source in moments)
    D1, D2 = a * a + b * b + C1, u - a * a + v - b * b + C2
    L, K = (2 * a * b + C1) / D1, (2 * (w - a * b) + C2) / D2
    S_a = 2 * K * (b - a * L) / D1 + 2 * L * (a * K - b) / D2
    return L * K, [S_a, -L * K / D2, 2 * L / D2]


def _of_columns(parts: Arrays, height: int, width: int) -> Arrays:
    """Apply mᵀ of eq. 6 along columns."""
    row, at, columns = _grid(height, width)
    index, last = row * columns + at, _size(height - SIDE)
    return [_spread(part, row, last, index, columns) for part in parts]


def _of_rows(parts: Arrays, height: int, width: int, channels: int) -> Arrays:
    """Apply mᵀ of eq. 6 along rows."""
    row, at, _ = _grid(height, width * channels)
    index, last = row * _size((width - SIDE + 1) * channels) + at, _size(width - SIDE)
    return [_spread(part, at // channels, last, index, channels) for part in parts]


class _Ssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, image: Tensor, target: Tensor) -> Tensor:
        H, W, C = image.shape
        x, y = flat_array(image), flat_array(target)
        moments = _moments(x, y, H, W, C)
        dr.eval(moments)
        windows = (W - SIDE + 1) * C
        S, parts = _similarity(moments, H, windows)
        dr.eval(S, parts)
        ctx.parts, ctx.count = parts, dr.width(S)
        ctx.save_for_backward(image, target)
        ctx.save_for_forward(image, target)
        dr.sync_thread()
        return S.torch().mean()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None]:
        return grad * _gradient(ctx), None

    @staticmethod
    def jvp(ctx: FunctionCtx, dimage: Tensor, _: None) -> Tensor:
        return (_gradient(ctx) * dimage).sum()


def _gradient(ctx: FunctionCtx) -> Tensor:
    """Return dS/dx of eq. 6, (H, W, C)."""
    image, target = ctx.saved_tensors
    H, W, C = image.shape
    parts = _of_columns(ctx.parts, H, (W - SIDE + 1) * C)
    dr.eval(parts)
    x, y = flat_array(image), flat_array(target)
    of_a, of_u, of_w = _of_rows(parts, H, W, C)
    found = (of_a + 2 * x * of_u + y * of_w) / ctx.count
    dr.eval(found)
    dr.sync_thread()
    return found.torch().view(H, W, C)
