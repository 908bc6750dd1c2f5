"""Fingers, which are bare skin and which the body model knows best.

What closes the holes of clothes also joins the fingers. So a surface around an avatar takes them
from the rest body, and Gaussians of fingers stay on them (:mod:`gva_mi.avatar.held`).
"""

from __future__ import annotations

import numpy as np

from gva_mi.avatar.offset_surface import SurfaceMesh
from gva_mi.avatar.rig import Rig
from gva_mi.body.skinning import finger_weights


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
