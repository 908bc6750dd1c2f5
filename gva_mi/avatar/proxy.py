"""The proxy: an avatar's outer skin as a mesh that moves with the Gaussians, for ray tracers.

1. v'  = v + D(v) c + MLP(theta)      v: a vertex at rest;  c, D, MLP: as for a Gaussian at v
2. v_t = A(v) v'                      eq. 1 and 2 of :mod:`gva_mi.avatar.avatar`

The skin is the surface of the last re-initialisation, with the fingers of the rest body, smoothed
once more: Gaussians do not mind a fold of it, but no light falls into one. An avatar that was never
re-initialised has the rest body with its clothes' offsets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.reinit import SURFACE_OPACITY, ReinitOptions, mesh_gaussians
from gva_mi.avatar.rig import moved_by
from gva_mi.avatar.surface import SurfaceMesh, with_fingers
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points

SMOOTHING = 10  # steps of Taubin's filter; chosen: folds of a few triangles come apart


@dataclass(frozen=True)
class Proxy:
    """An avatar's outer skin.

    Example:
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> proxy = Proxy.of(avatar)
        >>> torch.allclose(proxy.posed(Pose.rest()), avatar.skin.vertices, atol=1e-6)
        True
    """

    avatar: Avatar
    vertices: Tensor  # (V, 3) metres, at rest
    faces: Tensor  # (F, 3) int64, counter-clockwise seen from outside
    weights: Tensor  # (V, 55) skinning weights
    directions: Tensor  # (V, 3, K) metres by which blend shapes move the vertices

    @staticmethod
    @torch.no_grad()
    def of(avatar: Avatar, surface: SurfaceMesh | None = None) -> Proxy:
        """Take the skin of an avatar.

        ``surface`` is the surface of its last re-initialisation, without fingers. Without it, and
        if the avatar was re-initialised, a surface is made from its opaque Gaussians.
        """
        rig, skin = avatar.rig, avatar.skin
        if surface is None and len(skin.vertices) == len(rig.vertices):
            vertices, faces = skin.vertices, rig.faces
        else:
            if surface is None:
                G = avatar.canonical
                solid = G.opacities > SURFACE_OPACITY
                means, weights = (x[solid].double().numpy() for x in (G.means, G.weights))
                surface = mesh_gaussians(means, rig, ReinitOptions(), weights)
            whole = with_fingers(surface, rig)
            smooth = whole.meshlab()
            smooth.apply_coord_taubin_smoothing(stepsmoothnum=SMOOTHING)
            vertices = torch.from_numpy(smooth.current_mesh().vertex_matrix()).to(rig.vertices)
            faces = torch.from_numpy(np.ascontiguousarray(whole.faces))
        bound = skin.bind(vertices)
        return Proxy(avatar, vertices, faces, bound["weights"], bound["directions"])

    @torch.no_grad()
    def posed(self, pose: Pose) -> Tensor:
        """Return the vertices in a pose of one frame, (V, 3) metres, in the avatar's world."""
        skeleton = self.avatar.posed_skeleton(pose)
        moved = self.vertices + moved_by(skeleton.coefficients, self.directions)
        if self.avatar.options.residual.enabled:
            rotations = self.avatar.applied_rotations(pose)[0]
            moved = moved + self.avatar.residual(self.vertices, self.weights, rotations)
        return skin_points(moved, self.weights, skeleton.T_world_rest.to(moved.dtype))
