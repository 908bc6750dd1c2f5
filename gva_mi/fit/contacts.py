"""Contacts: where a picture shows two places of the body side by side that lie apart at rest.

An arm before the trunk is one, and so is a hand on the hip. There a pose that is off by a
centimetre gives pixels of one part to the other, so a frame k tells of a Gaussian i beside a
contact only

    q_ki = exp(-(r₀ / r_ki)²)

of what it tells of others, with r the distance to the nearest contact in the picture, metres.

This is not in the paper.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import AVATAR_SPLATTING
from gva_mi.splat import Camera, Gaussians, render

# r₀, metres. Chosen on three rendered persons: within half of it a contact teaches nothing, and
# poses of phone videos are off by as much.
CONTACT_REACH = 0.05
# Metres at rest between the places of a contact. Chosen: more than across a wrist.
CONTACT_APART = 0.1


@torch.no_grad()
def contact_free(gaussians: Gaussians, places: Tensor, camera: Camera) -> Tensor:
    """Return q of N posed Gaussians in a picture, (N,); ``places`` (N, 3) are theirs at rest."""
    return torch.exp(-((CONTACT_REACH / clearance(gaussians, places, camera)) ** 2))


def clearance(gaussians: Gaussians, places: Tensor, camera: Camera) -> Tensor:
    """Return how far Gaussians are from the nearest contact in a picture, (N,) metres: r.

    Args:
        gaussians: N posed Gaussians.
        places: (N, 3) where they are at rest, metres.
        camera: of the picture.
    """
    from scipy.ndimage import distance_transform_edt

    image = render(replace(gaussians, sh=None, colors=places), camera, AVATAR_SPLATTING)
    alpha = image.alpha.numpy()
    rest = image.color.numpy() / np.maximum(alpha, 0.5)[..., None]
    contact = np.zeros(alpha.shape, bool)
    for one, middle, other in (
        (np.s_[:-2], np.s_[1:-1], np.s_[2:]),
        (np.s_[:, :-2], np.s_[:, 1:-1], np.s_[:, 2:]),
    ):  # the neighbours on both sides of a pixel, which may itself mix two places
        solid = np.minimum(alpha[one], alpha[other]) > 0.5
        contact[middle] |= solid & (np.linalg.norm(rest[one] - rest[other], axis=2) > CONTACT_APART)
    if not contact.any():
        return torch.full((len(places),), torch.inf)
    pixels = distance_transform_edt(~contact)
    T = torch.tensor(camera.T_camera_world, dtype=places.dtype)
    x, y, z = (gaussians.means @ T[:3, :3].T + T[:3, 3]).T
    z = z.clamp_min(1e-3)
    column = (camera.fx * x / z + camera.cx).long().clamp(0, camera.width - 1)
    row = (camera.fy * y / z + camera.cy).long().clamp(0, camera.height - 1)
    return torch.from_numpy(pixels)[row, column].to(z) * z / camera.fx
