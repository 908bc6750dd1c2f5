"""Skin Gaussians by linear blend skinning: transforms, stretch and light as one kernel each way.

Each part has its formulas and its adjoint in a file of its own:

    1. A, E    = a Gaussian's LBS transform and its derivative   gva_mi.avatar.lbs_transforms
    2. μ', Σ'  = the Gaussian moved and stretched by them        gva_mi.avatar.stretch
    3. f       = its colour in the light                         gva_mi.avatar.lighting

Separate kernels would move 33 numbers per Gaussian to memory and back, which takes longer than
computing them. The backward pass reads the A and E that the forward pass kept. It writes rows of 24
numbers, [grad_A | grad_E | μ], from which the gradients of the joints' transforms are summed.
Tangents, which no fit needs, come from :mod:`gva_mi.avatar.lbs_reference`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr
import torch
from drjit import ArrayBase as Array
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import pad

from gva_mi.avatar import lbs_reference, lbs_transforms, lighting, stretch
from gva_mi.avatar.lbs_transforms import PairLists, SparseWeights
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.frozen import Frozen
from gva_mi.jit.rowwise import Lane, flat_array, load_columns, store_columns, to_tensors

WIDTHS = (3, 4, 3, 12)  # widths of rows of means, quats, scales and colours


def skin_gaussians(
    weights: SparseWeights,
    T_world_rest: Tensor,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    sh: Tensor,
    light: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Move N Gaussians from the rest pose into the world.

    Args:
        weights: skinning weights of the Gaussians.
        T_world_rest: (J, 4, 4) float64, the joints' transforms.
        means: (N, 3) metres, at rest.
        quats: (N, 4) wxyz, of any length.
        scales: (N, 3) metres.
        sh: (N, K, 3), K = 1 or 4: constant colours, and slopes along the axes of the rest pose.
        light: (3,) direction that the light comes from, in the world, of any length.

    Returns:
        Means (N, 3), covariances (N, 6) as xx, xy, xz, yy, yz, zz, and colours (N, 1, 3).
        Differentiable in all tensors, both ways.
    """
    T, direction = T_world_rest[:, :3].flatten(1), lighting.light_vector(light)
    coefficients = sh.flatten(1)
    if sh.shape[1] == 1:  # pad() copies even where it adds nothing
        coefficients = pad(coefficients, (0, WIDTHS[3] - 3))
    moved, covars, colors = _Skinned.apply(
        T, means, quats, scales, coefficients, direction, weights
    )
    return moved, covars, colors.unsqueeze(1)


@Frozen
def _forward(
    pairs: PairLists, T: Array, parts: list[Array], light: Array, *, n: int
) -> list[Array]:
    F = type(parts[0])
    mean, quat, scale, sh, l = _own(parts, light, n)
    A, E = ([F(x) for x in some] for some in lbs_transforms.forward(pairs, T, mean))
    moved, covars = stretch.forward(A, E, mean, quat, scale)
    color = lighting.forward(A, sh, l)
    kept = [*A, *E]
    found = [store_columns(some, n, F) for some in (moved, covars, color)]
    dr.eval(found, kept)
    return found + kept


@Frozen
def _adjoint(
    pairs: PairLists,
    T: Array,
    parts: list[Array],
    light: Array,
    kept: list[Array],
    grads: list[Array],
    *,
    n: int,
) -> list[Array]:
    """Return rows of the gradients of ``parts`` and the light, and of [grad_A | grad_E | μ]."""
    F = type(parts[0])
    mean, quat, scale, sh, l = _own(parts, light, n)
    A, E, lane = kept[:12], kept[12:], dr.arange(dr.uint32_array_t(F), n)
    g, G, g_color = (
        load_columns(x, width, lane) for x, width in zip(grads, (3, 6, 3), strict=True)
    )
    grad_A, grad_E, grad_mean, grad_quat, grad_scale = stretch.adjoint(
        A, E, mean, quat, scale, g, G
    )
    grad_sh, grad_A_lit, grad_light = lighting.adjoint(A, sh, l, g_color)
    grad_A = [a + b for a, b in zip(grad_A, grad_A_lit, strict=True)]
    by_E = lbs_transforms.adjoint_of_means(pairs, T, grad_E)
    grad_mean = [a + b for a, b in zip(grad_mean, by_E, strict=True)]
    columns = grad_mean, grad_quat, grad_scale, grad_sh, grad_light, [*grad_A, *grad_E, *mean]
    found = [store_columns(some, n, F) for some in columns]
    dr.eval(found)
    return found


@Frozen
def _adjoint_of_joints(pieces: PairLists, rows: Array, *, n: int) -> list[Array]:
    """Return the sums of each piece."""

    def of(gaussian: Array) -> tuple[Lane, Lane, Lane]:
        row = load_columns(rows, 24, gaussian)
        return row[:12], row[12:21], row[21:]

    sums = lbs_transforms.adjoint_of_joints(pieces, of)
    found = [store_columns(sums, n, type(sums[0]))]
    dr.eval(found)
    return found


def _own(parts: list[Array], light: Array, n: int) -> list[Lane]:
    """Read each lane's own rows, and the light, which all lanes share."""
    lane = dr.arange(dr.uint32_array_t(type(light)), n)
    own = [load_columns(part, width, lane) for part, width in zip(parts, WIDTHS, strict=True)]
    return [*own, load_columns(light, 3, lane * 0)]


class _Skinned(torch.autograd.Function):
    """Autograd function of T (J, 12) float64, means, quats, scales, sh (N, 12), light (1, 3)."""

    @staticmethod
    @exclusive
    def forward(ctx: FunctionCtx, *inputs: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        *given, weights = inputs
        T, *parts, light = given
        n = len(parts[0])
        ctx.weights = weights
        ctx.save_for_backward(*given)
        ctx.save_for_forward(*given)
        if not n:
            return parts[0].clone(), parts[0].new_zeros(0, 6), parts[0].clone()
        numbers = [flat_array(part) for part in parts]
        found = _forward(weights.of_gaussians, flat_array(T), numbers, flat_array(light), n=n)
        ctx.kept = found[3:]
        return to_tensors(found[:3], n)

    @staticmethod
    @torch.autograd.function.once_differentiable
    @exclusive
    def backward(ctx: FunctionCtx, *grads: Tensor) -> tuple[Tensor | None, ...]:
        T, *parts, light = ctx.saved_tensors
        n, weights = len(parts[0]), ctx.weights
        if not n:
            return *(torch.zeros_like(x) for x in (T, *parts, light)), None
        memory = (
            [flat_array(part) for part in parts],
            flat_array(light),
            ctx.kept,
            [flat_array(g) for g in grads],
        )
        own = flat_array(T.to(parts[0]))
        *by_parts, by_light, rows = _adjoint(weights.of_gaussians, own, *memory, n=n)
        by_T = None
        if ctx.needs_input_grad[0]:
            (sums,) = _adjoint_of_joints(weights.of_pieces, rows, n=len(weights.piece_joints))
            by_T = lbs_transforms.add_pieces(weights, sums, T)
        *by_parts, by_light = to_tensors([*by_parts, by_light], n)
        return by_T, *by_parts, by_light.sum(0, keepdim=True), None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        function = partial(lbs_reference.skinned, ctx.weights)
        return torch.autograd.functional.jvp(function, ctx.saved_tensors, tangents[:-1])[1]
