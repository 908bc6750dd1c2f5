"""A first guess of a film's poses: where the person is, and which way they face."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.data.landmarks import Landmarks
from gva_mi.pose.film.landmark_noise import PERSON, person_sizes

_AROUND = 5  # frames to each side, of a median


def first_root(landmarks: Landmarks) -> Tensor:
    """Return rotations (T, 3, 3) from the body's axes to the camera's, from the trunk's landmarks.

    Frames without a trunk take the nearest frame's.
    """
    at = landmarks.indices(["left_shoulder", "right_shoulder", "left_hip", "right_hip"])
    trunk = torch.from_numpy(landmarks.metric[:, at]).double()
    left_shoulder, right_shoulder, left_hip, right_hip = trunk.unbind(1)
    up = left_shoulder + right_shoulder - left_hip - right_hip
    aside = left_shoulder - right_shoulder + left_hip - right_hip
    y = normalize(up, dim=1)
    x = normalize(aside - (aside * y).sum(1, keepdim=True) * y, dim=1)
    R = torch.stack([x, y, torch.linalg.cross(x, y)], dim=2)
    return R[_nearest(R.flatten(1).isfinite().all(1).numpy())]


def first_place(landmarks: Landmarks, K: np.ndarray, scale: float) -> Tensor:
    """Return where the hips are, (T, 3) metres in the camera's axes.

    The distance is that at which a person has the size seen. ``K`` (3, 3) is the camera, ``scale``
    the body's size relative to the landmarks' metres. Frames without hips take the nearest frame's.
    """
    size = person_sizes(landmarks)
    around = [size[max(0, t - _AROUND) : t + _AROUND + 1] for t in range(len(size))]
    focal = (K[0, 0] + K[1, 1]) / 2
    z = focal * PERSON * scale / np.array([np.median(some) for some in around])
    hips = landmarks.pixels[:, landmarks.indices(["left_hip", "right_hip"])].mean(1)
    rays = (hips - K[:2, 2]) / [K[0, 0], K[1, 1]]
    place = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1) * z[:, None]
    return torch.from_numpy(place[_nearest(np.isfinite(rays).all(1))])


def _nearest(known: np.ndarray) -> list[int]:
    """Return of every frame the nearest one that is known."""
    some = np.flatnonzero(known)
    return [int(some[np.abs(some - t).argmin()]) for t in range(len(known))]
