"""Lambert's law, from which a fit learns how colours change with the light.

The colour of a Gaussian is linear in the direction t of the light at rest
(:mod:`gva_mi.avatar.lighting`). Pictures teach its slopes only along directions that the light
takes: a person who turns upright never shows a surface in the light from below. So slopes are
learned as differences from those of a matt surface,

    1. f_k = s n_k a + δ_k          k = x, y, z at rest

with n the normal of the rest surface beside the Gaussian, a its mean colour, and s one number for
the whole person, learned with them: how strong the light is beside that from all around. δ starts
at zero. What turning around teaches of s and of the light's direction then holds for raised arms.

When the fit is over, f takes the place of δ: an avatar knows nothing of this law.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from gva_mi.avatar.avatar import Avatar
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.kernels.sh import C0

STRENGTH = 1.0  # s at the start: turned to the light, a colour is 0.3 brighter than its mean


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
        self.strength = nn.Parameter(self._on_body.new_tensor(STRENGTH))
        self.follow(avatar)

    def follow(self, avatar: Avatar) -> None:
        """Take the normals beside the Gaussians where they are now."""
        skin = avatar.skin
        shares, vertices = skin.around(avatar.canonical.means)
        normals = (shares[..., None] * self._on_body[skin.beneath[vertices]]).sum(1)
        self.normals = torch.nn.functional.normalize(normals, dim=1)

    def __call__(self, sh: Tensor) -> Tensor:
        """Return f_0 and f (N, 4, 3) from f_0 and δ, differentiable in these and in s.

        Constant colours, (N, 1, 3), have no slopes and stay.
        """
        if sh.shape[1] == 1:
            return sh
        color = (sh[:, :1].detach() + 0.5 / C0).clamp_min(0)
        slopes = sh[:, 1:] + self.strength * self.normals[..., None] * color
        return torch.cat([sh[:, :1], slopes], 1)

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"strength": self.strength.detach().clone(), "normals": self.normals}

    @torch.no_grad()
    def load_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`state`, to the bit."""
        self.strength.copy_(state["strength"])
        self.normals = state["normals"]
