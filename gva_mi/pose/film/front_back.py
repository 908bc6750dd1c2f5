"""Frames in which a network took a person's back for the front: left and right are exchanged.

From behind, a person with long hair or a hood looks much as from the front. A network may then give
the left arm and leg the names of the right ones, with high confidence, for some frames. In the
landmarks all limbs jump to the other side of the body from one frame to the next, and jump back
later. As in :mod:`gva_mi.pose.swaps`, each frame is as given, ``s_k = 0``, or exchanged,
``s_k = 1``, and the states minimise

1. ``Σ_k (w Σ_p t_2(|x_k+1,p - x_k,p| / σ S Δt_k) + f_k s_k + g_k) + Σ_k (a s_k + b [s_k-1 < s_k])``

with the places ``x`` of shoulders, hips and limbs in the picture, left and right by the states, the
person's height ``S`` in pixels, the time ``Δt`` between two frames, and the cost ``t`` of Student's
t distribution. ``f`` is large where the face was found. If the network errs from one profile to the
next, no limb jumps. But then it shows a person from the front, of whom no face was found:

2. ``g_k = -log(1 - p c_k)``            of a frame without a face, otherwise 0

where ``c`` in [0, 1] is how much the trunk faces the camera, by its states, and ``p`` the share of
frontal frames in which this film shows a face. ``p`` follows from the states, and they from it.

The network's depths of such a frame are those of a person who looks at the camera. They are
removed.
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
FRONTAL = 0.12  # width of shoulders and hips, heights of the person, at which c is 1
ROUNDS = 5  # of states and p


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
    motion = TOGETHER * torch.from_numpy(motion)
    if not set(FACE) <= set(landmarks.names):
        data = torch.zeros(len(seen), 2, dtype=motion.dtype)
        return seen[least_states(data, motion, EACH).numpy()].tolist()
    face = np.isfinite(landmarks.pixels[seen][:, landmarks.indices(FACE)]).all((1, 2))
    frontal = _frontal(x, height)
    states = np.zeros(len(seen), bool)
    for _ in range(ROUNDS):
        data = SEEN_FACE * np.stack([np.zeros(len(seen)), face], 1)
        data[~face] -= np.log(1 - _share_of_faces(frontal, face, states) * frontal[~face])
        found = least_states(torch.from_numpy(data), motion, EACH).numpy()
        if (found == states).all():
            break
        states = found
    return seen[states].tolist()


def _frontal(x: np.ndarray, height: float) -> np.ndarray:
    """Return c (n, 2), as given and exchanged, of shoulders, hips and limbs ``x`` (n, P, 2).

    Of a person who faces the camera, the left side is on the right of the picture.
    """
    left, right = x[:, : len(PARTS), 0], x[:, len(PARTS) :, 0]
    wide = (left - right)[:, [PARTS.index("shoulder"), PARTS.index("hip")]].mean(1)
    return np.stack([wide, -wide], 1).clip(0, FRONTAL * height) / (FRONTAL * height)


def _share_of_faces(frontal: np.ndarray, face: np.ndarray, states: np.ndarray) -> float:
    """Return p: of frontal frames with a face, as if one more had it and one more had it not."""
    c = np.where(states, frontal[:, 1], frontal[:, 0])
    return float((c @ face + 1) / (c.sum() + 2))


def _cost(r: np.ndarray) -> np.ndarray:
    """Return the energy (n,) of steps (n, P), nats."""
    return ((FREEDOM + 2) / 2 * np.log1p(r**2 / FREEDOM)).sum(1)
