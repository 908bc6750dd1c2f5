"""Colours in the light of one pose, with exact gradients: one Dr.Jit kernel each way.

    1. t_k  = Σ_i A_ik l_i                         A_rotᵀ l: the light, seen from the rest pose
    2. f    = f_0 + Σ_k t_k f_k                    a Gaussian's colour, for red, green and blue

The light has a direction; its length is SHARE always, so that slopes are learned so much slower
than f_0, as the higher bands are in 3D Gaussian splatting. What light hardly changes while a person
turns upright, such as the pattern of a cloth, would else be learned half as slopes, and be wrong as
soon as an arm is raised.

And the adjoint, for a gradient g of f:

    3. grad_f_0 = g,    grad_f_k = t_k g
    4. grad_t_k = f_k · g,    grad_A_ik = l_i grad_t_k,    grad_l_i = Σ_n Σ_k A_ik grad_t_k

Near a bent joint the blend A_rot is no rotation and shortens the slopes: a little less contrast
there is harmless.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.rowwise import launch

AXES = range(3)
SHARE = 0.3  # |l|


def lit(sh: Tensor, A: Tensor, light: Tensor) -> Tensor:
    """Colours (N, 1, 3) in one pose.

    Args:
        sh: (N, K, 3), K = 1 or 4: constant colours f_0, then slopes f_k along the axes of the rest
            pose.
        A: (N, 12) blended maps of the pose, row by row, each [A_rot | A_trans].
        light: (3,) where the light comes from, in the world, of any length.

    Returns:
        Differentiable in everything, both ways; ``sh`` itself where there are no slopes.
    """
    if sh.shape[1] == 1:
        return sh
    return _Lit.apply(sh.flatten(1), A, direction(light)).unsqueeze(1)


def direction(light: Tensor) -> Tensor:
    """l (1, 3), of its length."""
    return SHARE * torch.nn.functional.normalize(light, dim=0).unsqueeze(0)


def _toward(A: list[Any], light: list[Any]) -> list[Any]:
    return [sum(A[4 * i + k] * light[i] for i in AXES) for k in AXES]


def forward(A: list[Any], sh: list[Any], light: list[Any]) -> tuple[list[Any]]:
    """Eq. 1 and 2."""
    t = _toward(A, light)
    return ([sh[c] + sum(t[k] * sh[3 * (1 + k) + c] for k in AXES) for c in AXES],)


def adjoint(
    A: list[Any], sh: list[Any], light: list[Any], g: list[Any]
) -> tuple[list[Any], list[Any], list[Any]]:
    """Eq. 3 and 4: by sh, A and the light."""
    t = _toward(A, light)
    grad_sh = [*g, *(t[k] * g[c] for k in AXES for c in AXES)]
    grad_t = [sum(sh[3 * (1 + k) + c] * g[c] for c in AXES) for k in AXES]
    grad_A = []
    for i in AXES:
        grad_A += [light[i] * grad_t[k] for k in AXES] + [0 * light[i]]
    grad_light = [sum(A[4 * i + k] * grad_t[k] for k in AXES) for i in AXES]
    return grad_sh, grad_A, grad_light


def tangent(
    A: list[Any], sh: list[Any], light: list[Any],
    dA: list[Any], dsh: list[Any], dlight: list[Any],
) -> tuple[list[Any]]:  # fmt: skip
    """Eq. 1 and 2, differentiated."""
    t = _toward(A, light)
    dt = [a + b for a, b in zip(_toward(dA, light), _toward(A, dlight), strict=True)]
    slope = lambda k, c: dt[k] * sh[3 * (1 + k) + c] + t[k] * dsh[3 * (1 + k) + c]
    return ([dsh[c] + sum(slope(k, c) for k in AXES) for c in AXES],)


class _Lit(torch.autograd.Function):
    """From sh (N, 12), A (N, 12) and light (1, 3) to colours (N, 3)."""

    @staticmethod
    def forward(ctx: FunctionCtx, sh: Tensor, A: Tensor, light: Tensor) -> Tensor:
        ctx.save_for_backward(sh, A, light)
        ctx.save_for_forward(sh, A, light)
        return launch(forward, A, sh, light)[0] if len(A) else sh[:, :3].clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, ...]:
        sh, A, light = ctx.saved_tensors
        if not len(A):
            return torch.zeros_like(sh), torch.zeros_like(A), torch.zeros_like(light)
        grad_sh, grad_A, grad_light = launch(adjoint, A, sh, light, grad)
        return grad_sh, grad_A, grad_light.sum(0, keepdim=True)

    @staticmethod
    def jvp(ctx: FunctionCtx, dsh: Tensor, dA: Tensor, dlight: Tensor) -> Tensor:
        sh, A, light = ctx.saved_tensors
        if not len(A):
            return dsh[:, :3].clone()
        return launch(tangent, A, sh, light, dA, dsh, dlight)[0]
