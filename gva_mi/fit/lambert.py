"""Colours that follow the light by Lambert's law, for a fit.

The colour of a Gaussian is linear in the direction t of the light at rest
(:mod:`gva_mi.avatar.skin_gaussians`). Pictures teach its slopes only along directions that the
light takes: a person who turns upright never shows a surface in the light from below. So slopes are
learned as differences from the slopes of a matt surface, Lambert's law:

    1. f_k = s n_k a + δ_k          k = x, y, z at rest

with n the normal of the rest surface beside the Gaussian, a its mean colour, and s one number for
the whole person, learned with them: the light's strength, relative to the ambient light. δ starts
at zero. What turning around teaches of s and of the light's direction then holds for raised arms.
Its adjoint, for gradients g_k of f_k (a is a constant):

    2. grad_δ_k = g_k,    grad_s = Σ n_k (Σ_c g_kc a_c)         over Gaussians and k; c: channels

When the fit is over, f takes the place of δ, so an avatar stores no trace of this law.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx
from torch.nn.functional import normalize

from gva_mi.avatar.avatar import Avatar
from gva_mi.jit.rowwise import Lane, launch
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.kernels.sh import C0

FIRST_STRENGTH = 1.0  # s; chosen: turned to the light, a colour is 0.3 brighter than its mean


class Lambert(nn.Module):
    """Lambert's law for the Gaussians of an avatar whose slopes are differences from it.

    Attributes:
        strength: () s.
        normals: (N, 3) n, unit; see :meth:`follow`.
    """

    def __init__(self, avatar: Avatar) -> None:
        super().__init__()
        rig = avatar.rig
        self._on_body = vertex_normals(rig.vertices, rig.faces)
        self.strength = nn.Parameter(self._on_body.new_tensor(FIRST_STRENGTH))
        self.follow(avatar)

    def follow(self, avatar: Avatar) -> None:
        """Take the normals beside the Gaussians where they are now."""
        normals = avatar.skin.beneath_points(avatar.canonical.means, self._on_body)
        self.normals = normalize(normals, dim=1)

    def forward(self, sh: Tensor) -> Tensor:
        """Return f_0 and f (N, 4, 3) from f_0 and δ, differentiable in these and in s.

        Constant colours, (N, 1, 3), have no slopes and stay.
        """
        if sh.shape[1] == 1 or not len(sh):
            return sh
        return _Lit.apply(sh, self.normals, self.strength)

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"strength": self.strength.detach().clone(), "normals": self.normals}

    @torch.no_grad()
    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`state`, to the bit."""
        self.strength.copy_(state["strength"])
        self.normals = state["normals"]


def _color(sh: Lane) -> Lane:
    """Return the mean colour a of eq. 1, in the unit of sh."""
    return [dr.maximum(x + 0.5 / C0, 0) for x in sh[:3]]


def _forward(sh: Lane, normal: Lane, strength: Lane) -> list[Lane]:
    """Evaluate eq. 1 for sh, which holds f_0 and δ."""
    law = [strength[0] * n * a for n in normal for a in _color(sh)]
    return [sh[:3] + [d + x for d, x in zip(sh[3:], law, strict=True)]]


def _adjoint(sh: Lane, grad: Lane) -> list[Lane]:
    """Evaluate the sums over channels of eq. 2."""
    a = _color(sh)
    return [[sum(grad[3 * k + c] * a[c] for c in range(3)) for k in (1, 2, 3)]]


class _Lit(torch.autograd.Function):
    """Autograd function of sh (N, 4, 3), normals (N, 3), which are constant, and strength ()."""

    @staticmethod
    def forward(ctx: FunctionCtx, sh: Tensor, normals: Tensor, strength: Tensor) -> Tensor:
        ctx.save_for_backward(sh, normals)
        (lit,) = launch(_forward, sh.flatten(1), normals, strength.view(1, 1))
        return lit.view(sh.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None, Tensor]:
        sh, normals = ctx.saved_tensors
        (by_law,) = launch(_adjoint, sh.flatten(1), grad.flatten(1))
        return grad, None, (by_law * normals).sum()
