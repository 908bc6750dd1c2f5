"""Compositing of a person and a render on the same background: Dr.Jit kernels, one lane per pixel.

In a box of a picture, with P the picture, S the person's mask, B what is behind the person, b a
colour, and U where the mask is uncertain; outside the box the background is b:

    1. background = B where U, else b
    2. target     = P where U, else S P + (1 - S) b
    3. image      = C + (1 - A) background          C, A: colour and alpha of a render

And the adjoint of 3, for a gradient g of the image:

    4. grad_C = g,    grad_A = -Σ_c g_c background_c

A pixel is read as one integer of four bytes: P with S, and B with U.
"""

from __future__ import annotations

import drjit as dr
import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64, Int32, UInt32
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.data.crop import Box
from gva_mi.jit.rowwise import flat_array, load_columns, store_columns, to_tensors


def composite_target(
    person: Tensor, behind: Tensor, color: Tensor, box: Box, part: Box
) -> tuple[Tensor, Tensor, Tensor]:
    """Composite a person on a background (eq. 1 and 2) in a part of a picture.

    Args:
        person: (h, w, 4) uint8, P and S.
        behind: (h, w, 4) uint8, B and U (zero or not).
        color: (3,) in [0, 1], b.
        box: their place in the whole picture.
        part: place of the results; contains ``box``.

    Returns:
        The target (H, W, 3), the background (H, W, 3), and the mask (H, W) in [0, 1].
    """
    pixel, inside = _in_box(box, part)
    *P, S = _bytes(dr.gather(UInt32, _pixels(person), pixel, inside))
    *B, U = _bytes(dr.gather(UInt32, _pixels(behind), pixel, inside))
    b = [dr.opaque(Float, value) for value in color.tolist()]
    on_color = [dr.lerp(b_c, P_c, S) for b_c, P_c in zip(b, P, strict=True)]
    here = lambda unsure, sure: [dr.select(U > 0, u, s) for u, s in zip(unsure, sure, strict=True)]
    count = part.width * part.height
    found = [
        store_columns(here(P, on_color), count, Float),
        store_columns(here(B, b), count, Float),
        S,
    ]
    dr.eval(found)
    target, background, mask = (
        x.view(part.height, part.width, -1) for x in to_tensors(found, count)
    )
    return target, background, mask[..., 0]


def composite_render(color: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
    """Composite a render on a background (eq. 3).

    Args:
        color: (H, W, 3) of a render on black, C.
        alpha: (H, W) of the render, A.
        background: (H, W, 3), constant.

    Returns:
        (H, W, 3), differentiable in the render both ways.
    """
    return _CompositeRender.apply(color, alpha, background.detach())


class _CompositeRender(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, color: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
        ctx.save_for_backward(background)
        ctx.save_for_forward(background)
        C, A, B = (flat_array(x) for x in (color, alpha, background))
        through = 1 - dr.gather(type(A), A, dr.arange(UInt32, color.numel()) // 3)
        return _done(dr.fma(through, B, C), color.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        (background,) = ctx.saved_tensors
        pixel = dr.arange(UInt32, grad.shape[0] * grad.shape[1])
        g, B = (load_columns(flat_array(x), 3, pixel) for x in (grad, background))
        grad_alpha = -sum(x * y for x, y in zip(g, B, strict=True))
        return grad, _done(grad_alpha, grad.shape[:2]), None

    @staticmethod
    def jvp(ctx: FunctionCtx, dcolor: Tensor, dalpha: Tensor, _: None) -> Tensor:
        (background,) = ctx.saved_tensors
        return torch.addcmul(dcolor, dalpha[..., None], background, value=-1)


def _done(numbers: Array, shape: torch.Size) -> Tensor:
    dr.eval(numbers)
    return to_tensors([numbers], len(numbers))[0].view(shape)


def _in_box(box: Box, part: Box) -> tuple[UInt32, Array]:
    """Return the pixel of ``box`` at each pixel of ``part``, and whether there is one."""
    lane = dr.arange(UInt32, part.width * part.height)
    # Sizes are opaque, or every box would compile kernels of its own. Floats are divided in
    # packets, integers one by one.
    number = lambda value: dr.opaque(Int32, value)
    row = Int32(dr.floor((Float64(lane) + 0.5) * dr.opaque(Float64, 1 / part.width)))
    column = Int32(lane) - row * number(part.width) - number(box.left - part.left)
    row = row - number(box.top - part.top)
    inside = (row >= 0) & (row < number(box.height)) & (column >= 0) & (column < number(box.width))
    return UInt32(row * number(box.width) + column), inside


def _pixels(image: Tensor) -> UInt32:
    """View an image (h, w, 4) uint8 as one integer per pixel."""
    return UInt32(image.contiguous().view(torch.int32).view(-1).numpy().view("uint32"))


def _bytes(pixel: UInt32) -> list[Float]:
    """Return the four bytes of each pixel, in [0, 1], lowest first."""
    return [Float((pixel >> (8 * k)) & 255) / 255 for k in range(4)]
