"""Compare a render with a person on the same background: Dr.Jit kernels, one lane per pixel.

In a box of a picture, with P the picture, S the person's mask, B what is behind the person, b a
colour, and U where the mask is uncertain; outside the box the background is b:

    1. background = B where U, else b
    2. target     = P where U, else S P + (1 - S) b
    3. image      = C + (1 - A) background          C, A: colour and alpha of a render
    4. error      = Σ |image - target| / 3 a        over pixels and channels; a: a number of pixels
    5. mask error = Σ |A - S| / a                   over pixels

And their adjoints, which are computed with them:

    6. grad_C = sign(image - target) / 3 a,    grad_A = -Σ_c grad_C,c background_c
    7. grad_A = sign(A - S) / a

Pixels of an overlay, such as a caption, show nothing of what is behind: their errors are 0.

A pixel is read as one integer of four bytes: P with S, and B with U. Nothing of eq. 1 to 3 is
stored, because that takes longer than computing it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64, Int32, UInt32
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.frozen import Frozen, exclusive
from gva_mi.jit.packets import store_rows
from gva_mi.jit.rowwise import Lane, flat_array, load_columns, store_columns, to_tensors
from gva_mi.jit.tensors import tensor_of
from gva_mi.splat.kernels.tiles import capacity
from gva_mi.subject.crop import Box

OVERLAY = 128  # U of pixels on an overlay


@dataclass(frozen=True)
class Cutout:
    """A person cut out of a picture, and the colour of a new background."""

    person: Tensor  # (h, w, 4) uint8, P and S
    behind: Tensor  # (h, w, 4) uint8, B and U: zero, 255, or OVERLAY
    box: Box  # their place in the whole picture
    color: Tensor  # (3,) in [0, 1], b


class CompositeTarget(NamedTuple):
    """A part of a picture as a render should equal it, all in [0, 1]."""

    target: Tensor  # (H, W, 3)
    background: Tensor  # (H, W, 3)
    mask: Tensor  # (H, W)
    shown: Tensor  # (H, W) 0 on an overlay, else 1


@exclusive
def composite_target(cutout: Cutout, part: Box) -> CompositeTarget:
    """Composite a person on a background (eq. 1 and 2) in a part of a picture."""
    count = part.width * part.height
    # Not frozen: a replay could not know the size, because no array of this size is read.
    target, background, S, shown = _composite(*_arrays(cutout, part), dr.arange(UInt32, count))
    columns = [store_columns(x, count, Float) for x in (target, background)]
    found = [*columns, S, dr.select(shown, Float(1), 0)]
    dr.eval(found)
    shape = part.height, part.width, -1
    target, background, *single = (x.view(shape) for x in to_tensors(found, count))
    return CompositeTarget(target, background, *(x[..., 0] for x in single))


def composite_render(color: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
    """Composite a render on a background (eq. 3), differentiable.

    Args:
        color: (H, W, 3) of a render on black, C.
        alpha: (H, W) of the render, A.
        background: (H, W, 3).
    """
    return torch.addcmul(color, 1 - alpha[..., None], background)


def absolute_errors(
    color: Tensor, alpha: Tensor, cutout: Cutout, part: Box, area: float
) -> tuple[Tensor, Tensor]:
    """Return the errors of a render on a new background, and of its mask (eq. 4 and 5), scalars.

    Args:
        color: (H, W, 3) of a render of this part on black, C.
        alpha: (H, W) of the render, A.
        cutout: the person.
        part: of the picture.
        area: a.

    Returns:
        Differentiable once in the render.
    """
    return _AbsoluteErrors.apply(color, alpha, cutout, part, area)


class _AbsoluteErrors(torch.autograd.Function):
    @staticmethod
    @exclusive
    def forward(
        ctx: FunctionCtx, color: Tensor, alpha: Tensor, cutout: Cutout, part: Box, area: float
    ) -> tuple[Tensor, Tensor]:
        C, A = flat_array(color), flat_array(alpha)
        unit, size = dr.opaque(type(A), 1 / area), capacity(alpha.numel())
        *errors, by_color, by_alpha, by_mask = _compare(
            C, A, *_arrays(cutout, part), unit, size=size
        )
        dr.sync_thread()
        pairs = (by_color, color), (by_alpha, alpha), (by_mask, alpha)
        ctx.by = [tensor_of(x, given.numel()).view(given.shape) for x, given in pairs]
        ctx.set_materialize_grads(False)
        error, of_mask = (tensor_of(x).sum() for x in errors)
        return error, of_mask

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: FunctionCtx, grad: Tensor | None, of_mask: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        by_color, by_alpha, by_mask = ctx.by
        if grad is None:
            by_color, by_alpha = None, torch.zeros_like(by_alpha)
        elif grad != 1:
            by_color, by_alpha = grad * by_color, grad * by_alpha
        if of_mask is not None:
            by_alpha = torch.add(by_alpha, by_mask, alpha=float(of_mask))
        return by_color, by_alpha, None, None, None


@Frozen
def _compare(
    C: Array,
    A: Array,
    pixels: list[UInt32],
    color: list[Float],
    place: list[Array],
    unit: Array,
    *,
    size: int,
) -> list[Array]:
    """Evaluate eq. 4 and 5 of each pixel, and eq. 6 and 7; ``unit`` is 1 / a.

    Gradients by C lie in memory for ``size`` pixels.
    """
    F, lane = type(A), dr.arange(UInt32, dr.width(A))
    wanted, background, S, shown = _composite(pixels, color, place, lane)
    through, C, third = 1 - A, load_columns(C, 3, lane), unit / 3
    slope = lambda x, unit: dr.select(x > 0, unit, dr.select(x < 0, -unit, 0))
    off = [dr.fma(through, F(b), c) - F(t) for c, b, t in zip(C, background, wanted, strict=True)]
    off = [dr.select(shown, x, 0) for x in off]
    grad, of_mask = [slope(x, third) for x in off], dr.select(shown, A - F(S), 0)
    error, by_color = third * sum(dr.abs(x) for x in off), dr.empty(F, 3 * size)
    by_alpha = -sum(g * F(b) for g, b in zip(grad, background, strict=True))
    store_rows(by_color, grad, lane)
    found = [error, unit * dr.abs(of_mask), by_color, by_alpha, slope(of_mask, unit)]
    dr.eval(found)
    return found


def _composite(
    pixels: list[UInt32], color: list[Float], place: list[Array], lane: UInt32
) -> tuple[Lane, Lane, Float, Array]:
    """Evaluate eq. 1 and 2 at pixels of a part: target, background, mask, and whether it counts."""
    pixel, inside = _in_box(place, lane)
    *P, S = _bytes(dr.gather(UInt32, pixels[0], pixel, inside))
    *B, U = _bytes(dr.gather(UInt32, pixels[1], pixel, inside))
    on_color = [dr.lerp(b_c, P_c, S) for b_c, P_c in zip(color, P, strict=True)]
    here = lambda unsure, sure: [dr.select(U > 0, u, s) for u, s in zip(unsure, sure, strict=True)]
    return here(P, on_color), here(B, color), S, (U < 0.25) | (U > 0.75)


def _arrays(cutout: Cutout, part: Box) -> tuple[list[UInt32], list[Float], list[Array]]:
    """Return what :func:`_composite` reads; opaque, or every box would compile its own kernels."""
    box = cutout.box
    numbers = part.width, box.left - part.left, box.top - part.top, box.width, box.height
    place = [dr.opaque(Float64, 1 / part.width), *(dr.opaque(Int32, x) for x in numbers)]
    color = [dr.opaque(Float, x) for x in cutout.color.tolist()]
    return [_pixels(cutout.person), _pixels(cutout.behind)], color, place


def _in_box(place: list[Array], lane: UInt32) -> tuple[UInt32, Array]:
    """Return which pixels of a cutout lie at pixels of a part, and whether any does."""
    # Floats are divided in packets, integers one by one.
    per_row, columns, left, top, width, height = place
    row = Int32(dr.floor((Float64(lane) + 0.5) * per_row))
    column = Int32(lane) - row * columns - left
    row = row - top
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return UInt32(row * width + column), inside


def _pixels(image: Tensor) -> UInt32:
    """View an image (h, w, 4) uint8 as one integer per pixel."""
    return UInt32(image.contiguous().view(torch.int32).view(-1).numpy().view("uint32"))


def _bytes(pixel: UInt32) -> list[Float]:
    """Return the four bytes of each pixel, in [0, 1], lowest first."""
    return [Float((pixel >> (8 * k)) & 255) / 255 for k in range(4)]
