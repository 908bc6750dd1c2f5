"""Fingers, which are bare skin and which the body model knows best.

What a video teaches of them is little and wrong: a finger is a few pixels wide, often hidden, and
its pose is off by more than its width. Gaussians that follow such pictures leave the finger, take
the colours of what is behind it, and tear off once the hand opens. So a re-initialisation puts them
on the body's own fingers, and there they stay, within :data:`REACH`.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.offset_surface import SurfaceMesh
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND

REACH = 0.004  # metres that a Gaussian of a finger may be off the body's surface


def finger_weights(weights: Tensor) -> Tensor:
    """Return the share of each row of skinning weights (N, 55) that belongs to fingers, (N,)."""
    return weights[:, LEFT_HAND].sum(1) + weights[:, RIGHT_HAND].sum(1)


def with_fingers(surface: SurfaceMesh, rig: Rig) -> SurfaceMesh:
    """Replace the fingers of a surface by those of the rest body."""
    from scipy.spatial import cKDTree

    body, faces = rig.vertices.double().numpy(), rig.faces.numpy()
    finger = finger_weights(rig.weights).numpy() > 0.5
    if not finger.any():
        return surface
    bridged = finger[cKDTree(body).query(surface.vertices[surface.faces].mean(1))[1]]
    own = faces[finger[faces].all(1)] + len(surface.vertices)
    both = np.vstack([surface.vertices, body]), np.vstack([surface.faces[~bridged], own])
    return SurfaceMesh(*both).part(np.ones(len(both[1]), dtype=bool))


class Fingers:
    """The fingers of an avatar's rest body, and the Gaussians that must stay on them."""

    def __init__(self, rig: Rig) -> None:
        from scipy.spatial import cKDTree

        self._surface = rig.vertices[finger_weights(rig.weights) > 0.5]
        self._tree = cKDTree(self._surface.double().numpy()) if len(self._surface) else None

    @torch.no_grad()
    def hold(self, avatar: Avatar) -> None:
        """Move Gaussians of fingers that have left the body back, to :data:`REACH` from it."""
        G = avatar.canonical
        mine = (finger_weights(G.weights) > 0.5).nonzero()[:, 0]
        if self._tree is None or not len(mine):
            return
        means = G.means[mine]
        distance, nearest = self._tree.query(means.double().numpy())
        distance = torch.from_numpy(distance).to(means)
        beneath = self._surface[torch.from_numpy(nearest)]
        share = (REACH / distance.clamp_min(1e-9)).clamp_max(1)[:, None]
        G.means[mine] = beneath + share * (means - beneath)
