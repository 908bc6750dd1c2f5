"""From the joints' maps to Gaussians in the world: blend, stretch and light as one kernel each way.

What is computed stands elsewhere, each with its adjoint and its tangent:

    1. A, E    = the blended maps of a Gaussian, and how they change    :mod:`gva_mi.avatar.maps`
    2. μ', Σ'  = the Gaussian carried and stretched by them             :mod:`gva_mi.avatar.stretch`
    3. f       = its colour in the light                                :mod:`gva_mi.avatar.light`

One after the other, 33 numbers of each Gaussian would go to memory and back between them, which
takes longer than computing them. The way back reads A and E, which the way there has kept; what the
maps' gradients are summed up from is kept as rows of 24 numbers, [grad_A | grad_E | μ].
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from drjit import ArrayBase as Array
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import pad

from gva_mi.avatar import light as light_of
from gva_mi.avatar import stretch
from gva_mi.avatar.maps import (
    FollowedJoints,
    Pairs,
    add_pieces,
    adjoint_of_maps,
    adjoint_of_means,
    blend,
)
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.frozen import Frozen
from gva_mi.jit.rowwise import flat, in_rows, launch, of_rows, tensors

Lane = list[Any]  # numbers of one Gaussian
WIDTHS = (3, 4, 3, 12)  # of the rows of means, quats, scales and colours


def carry(
    joints: FollowedJoints,
    T_world_rest: Tensor,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    sh: Tensor,
    light: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Eq. 1 to 3.

    Args:
        joints: that the N Gaussians follow.
        T_world_rest: (J, 4, 4) float64, the joints' maps.
        means: (N, 3) metres, at rest.
        quats: (N, 4) wxyz, of any length.
        scales: (N, 3) metres.
        sh: (N, K, 3), K = 1 or 4: constant colours, and slopes.
        light: (3,) where the light comes from, of any length.

    Returns:
        Means (N, 3), covariances (N, 6) as of :func:`gva_mi.avatar.stretch.carry_stretched`, and
        colours (N, 1, 3). Differentiable in all tensors, both ways.
    """
    T, direction = T_world_rest[:, :3].flatten(1), light_of.direction(light)
    coefficients = pad(sh.flatten(1), (0, WIDTHS[3] - 3 * sh.shape[1]))
    moved, covars, colors = _Carry.apply(T, means, quats, scales, coefficients, direction, joints)
    return moved, covars, colors.unsqueeze(1)


@Frozen
def _forward(pairs: Pairs, maps: Array, parts: list[Array], light: Array, *, n: int) -> list[Array]:
    F = type(parts[0])
    mean, quat, scale, sh, l = _own(parts, light, n)
    A, E = ([F(x) for x in some] for some in blend(pairs, maps, mean))
    moved, covars = stretch.forward(A, E, mean, quat, scale)
    (color,) = light_of.forward(A, sh, l)
    kept = [*A, *E]
    found = [in_rows(some, n, F) for some in (moved, covars, color)]
    dr.eval(found, kept)
    return found + kept


@Frozen
def _adjoint(
    pairs: Pairs,
    maps: Array,
    parts: list[Array],
    light: Array,
    kept: list[Array],
    grads: list[Array],
    *,
    n: int,
) -> list[Array]:
    """Rows of the gradients by ``parts`` and the light, and of [grad_A | grad_E | μ]."""
    F = type(parts[0])
    mean, quat, scale, sh, l = _own(parts, light, n)
    A, E, lane = kept[:12], kept[12:], dr.arange(dr.uint32_array_t(F), n)
    g, G, g_color = (of_rows(x, width, lane) for x, width in zip(grads, (3, 6, 3), strict=True))
    grad_A, grad_E, grad_mean, grad_quat, grad_scale = stretch.adjoint(
        A, E, mean, quat, scale, g, G
    )
    grad_sh, grad_A_lit, grad_light = light_of.adjoint(A, sh, l, g_color)
    grad_A = [a + b for a, b in zip(grad_A, grad_A_lit, strict=True)]
    by_E = adjoint_of_means(pairs, maps, grad_E)
    grad_mean = [a + F(b) for a, b in zip(grad_mean, by_E, strict=True)]
    columns = grad_mean, grad_quat, grad_scale, grad_sh, grad_light, [*grad_A, *grad_E, *mean]
    found = [in_rows(some, n, F) for some in columns]
    dr.eval(found)
    return found


@Frozen
def _adjoint_of_maps(pieces: Pairs, rows: Array, *, n: int) -> list[Array]:
    """Of each piece, float64."""

    def of(gaussian: Array) -> tuple[Lane, Lane, Lane]:
        row = of_rows(rows, 24, gaussian)
        return row[:12], row[12:21], row[21:]

    sums = adjoint_of_maps(pieces, of)
    found = [in_rows(sums, n, type(sums[0]))]
    dr.eval(found)
    return found


def _own(parts: list[Array], light: Array, n: int) -> list[Lane]:
    """Each lane's own rows, and the light, which is the same in all."""
    lane = dr.arange(dr.uint32_array_t(type(light)), n)
    own = [of_rows(part, width, lane) for part, width in zip(parts, WIDTHS, strict=True)]
    return [*own, of_rows(light, 3, lane * 0)]


class _Carry(torch.autograd.Function):
    """From T (J, 12) float64, means, quats, scales, sh (N, 12), light (1, 3)."""

    @staticmethod
    @exclusive
    def forward(ctx: FunctionCtx, *inputs: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        *given, joints = inputs
        T, *parts, light = given
        n = len(parts[0])
        ctx.joints = joints
        ctx.save_for_backward(*given)
        ctx.save_for_forward(*given)
        if not n:
            return parts[0].clone(), parts[0].new_zeros(0, 6), parts[0].clone()
        numbers = [flat(part) for part in parts]
        found = _forward(joints.of_gaussians, flat(T), numbers, flat(light), n=n)
        ctx.kept = found[3:]
        return tensors(found[:3], n)

    @staticmethod
    @torch.autograd.function.once_differentiable
    @exclusive
    def backward(ctx: FunctionCtx, *grads: Tensor) -> tuple[Tensor | None, ...]:
        T, *parts, light = ctx.saved_tensors
        n, joints = len(parts[0]), ctx.joints
        if not n:
            return *(torch.zeros_like(x) for x in (T, *parts, light)), None
        memory = [flat(part) for part in parts], flat(light), ctx.kept, [flat(g) for g in grads]
        *by_parts, by_light, rows = _adjoint(joints.of_gaussians, flat(T), *memory, n=n)
        by_T = None
        if ctx.needs_input_grad[0]:
            (sums,) = _adjoint_of_maps(joints.of_pieces, rows, n=len(joints.joints))
            by_T = add_pieces(joints, sums, T)
        *by_parts, by_light = tensors([*by_parts, by_light], n)
        return by_T, *by_parts, by_light.sum(0, keepdim=True), None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        T, means, quats, scales, sh, light = ctx.saved_tensors
        dT, dmeans, dquats, dscales, dsh, dlight, _ = tangents
        if not len(means):
            return means.clone(), means.new_zeros(0, 6), means.clone()
        A, E = ctx.joints.blended(T, means)
        dA, dE = ctx.joints.tangent(T, means, dT, dmeans)
        of, along = (A, E, means, quats, scales), (dA, dE, dmeans, dquats, dscales)
        dmoved, dcovars = launch(stretch.tangent, *of, *along)
        (dcolors,) = launch(light_of.tangent, A, sh, light, dA, dsh, dlight)
        return dmoved, dcovars, dcolors
