"""Frames in which a network took a person's back for the front: left and right are exchanged.

From behind, a person with long hair or a hood looks much as from the front. A network may then give
the left arm and leg the names of the right ones, with high confidence, for some frames. In the
landmarks all limbs jump to the other side of the body from one frame to the next, and jump back
later. As in :mod:`gva_mi.pose.swaps`, each frame is as given, ``s_k = 0``, or exchanged,
``s_k = 1``, and the states minimise

1. ``Σ_k (w Σ_p t_2(|x_k+1,p - x_k,p| / σ S Δt_k) + f_k s_k) + Σ_k (a s_k + b [s_k-1 < s_k])``

with the places ``x`` of shoulders, hips and limbs in the picture, left and right by the states, the
person's height ``S`` in pixels, the time ``Δt`` between two frames, and the cost ``t`` of Student's
t distribution. ``f`` is large where the face was found.

The network's depths of such a frame are those of a person who looks at the camera. They are
removed. If the network errs from one profile to the other, no limb jumps: this is not found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from gva_mi.body.pose import SIDES, mirrored_name
from gva_mi.data.landmarks import FACE, Landmarks
from gva_mi.pose.prior.error_model import FREEDOM
from gva_mi.pose.swaps import TOGETHER, least_states

PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
SPEED = 0.9  # σ: of limbs in the picture, heights of the person a second
EACH = 0.3  # a, nats: mistakes last, so a frame says little
SEEN_FACE = 5.0  # f, nats, of a frame with a face


def with_backs(landmarks: Landmarks, fps: float) -> tuple[Landmarks, list[int]]:
    """Return landmarks whose left and right are exchanged where needed, and in which frames.

    Args:
        landmarks: T frames; names without a side, and frames without the person, stay.
        fps: frames a second.
    """
    frames = _mistaken(landmarks, fps)
    if not frames:
        return landmarks, []
    names = list(landmarks.names)
    other = [mirrored_name(name) for name in names]
    order = [names.index(b if b in names else a) for a, b in zip(names, other, strict=True)]
    found = {}
    for field in ("pixels", "confidence", "spread", "metric"):
        found[field] = getattr(landmarks, field).copy()
        found[field][frames] = found[field][frames][:, order]
    found["metric"][frames] = np.nan
    return replace(landmarks, **found), frames


def _mistaken(landmarks: Landmarks, fps: float) -> list[int]:
    """Return the frames whose states are exchanged (eq. 1)."""
    wanted = [f"{side}_{part}" for side in SIDES for part in PARTS]
    if not set(wanted) <= set(landmarks.names):
        return []
    x = landmarks.pixels[:, landmarks.indices(wanted)].astype(float)
    seen = np.flatnonzero(np.isfinite(x).all((1, 2)))
    if len(seen) < 2:
        return []
    x = x[seen]
    height = np.median(np.ptp(x[..., 1], axis=1))
    crossed = np.roll(x, len(PARTS), axis=1)
    usual = SPEED * height * np.diff(seen)[:, None] / fps
    same, changed = (
        _cost(np.linalg.norm(x[1:] - before[:-1], axis=-1) / usual) for before in (x, crossed)
    )
    motion = np.stack([np.stack([same, changed], -1), np.stack([changed, same], -1)], -2)
    data = np.zeros((len(seen), 2))
    if set(FACE) <= set(landmarks.names):
        face = np.isfinite(landmarks.pixels[seen][:, landmarks.indices(FACE)]).all((1, 2))
        data[:, 1] = SEEN_FACE * face
    states = least_states(torch.from_numpy(data), TOGETHER * torch.from_numpy(motion), EACH)
    return seen[states.numpy()].tolist()


def _cost(r: np.ndarray) -> np.ndarray:
    """Return the energy (n,) of steps (n, P), nats."""
    return ((FREEDOM + 2) / 2 * np.log1p(r**2 / FREEDOM)).sum(1)
