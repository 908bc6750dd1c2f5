"""Colours in the light of one pose: formulas and adjoint, on the numbers of one Gaussian.

    1. t_k  = Σ_i A_ik l_i                         A_rotᵀ l: the light, seen from the rest pose
    2. f    = f_0 + Σ_k t_k f_k                    a Gaussian's colour, for red, green and blue

The light l has a direction; its length is always SHARE, so that slopes are learned more slowly
than f_0, like the higher bands in 3D Gaussian splatting. Otherwise details that hardly depend on
light while a person turns upright, such as the pattern of a cloth, would be learned half as slopes
and be wrong once an arm is raised.

And the adjoint, for a gradient g of f:

    3. grad_f_0 = g,    grad_f_k = t_k g
    4. grad_t_k = f_k · g,    grad_A_ik = l_i grad_t_k,    grad_l_i = Σ_n Σ_k A_ik grad_t_k

Near a bent joint the blend A_rot is no rotation and shortens the slopes, which is harmless.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.jit.rowwise import Lane

AXES = range(3)
SHARE = 0.3  # |l|


def light_vector(light: Tensor) -> Tensor:
    """Return l (1, 3) of length SHARE, from a direction (3,) of any length."""
    return SHARE * torch.nn.functional.normalize(light, dim=0).unsqueeze(0)


def _at_rest(A: Lane, light: Lane) -> Lane:
    """Evaluate eq. 1."""
    return [sum(A[4 * i + k] * light[i] for i in AXES) for k in AXES]


def forward(A: Lane, sh: Lane, light: Lane) -> Lane:
    """Evaluate eq. 1 and 2."""
    t = _at_rest(A, light)
    return [sh[c] + sum(t[k] * sh[3 * (1 + k) + c] for k in AXES) for c in AXES]


def adjoint(A: Lane, sh: Lane, light: Lane, g: Lane) -> tuple[Lane, Lane, Lane]:
    """Evaluate eq. 3 and 4: gradients of sh, A and the light."""
    t = _at_rest(A, light)
    grad_sh = [*g, *(t[k] * g[c] for k in AXES for c in AXES)]
    grad_t = [sum(sh[3 * (1 + k) + c] * g[c] for c in AXES) for k in AXES]
    grad_A = []
    for i in AXES:
        grad_A += [light[i] * grad_t[k] for k in AXES] + [0 * light[i]]
    grad_light = [sum(A[4 * i + k] * grad_t[k] for k in AXES) for i in AXES]
    return grad_sh, grad_A, grad_light
