"""Interpolate rotations between frames: missing frames, another frame rate.

    r(t) = r_k ∘ exp(s log(r_k⁻¹ ∘ r_k+1)),    s = (t − t_k) / (t_k+1 − t_k)

joint by joint, on the shorter way round. Other numbers are interpolated linearly.
"""

from __future__ import annotations

import numpy as np
import roma
import torch


def interpolate(
    times: np.ndarray, rotations: np.ndarray, others: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sample rotations (n, J, 3) and other numbers (n, D) at times ``wanted`` (m,).

    ``times`` (n,) ascend; the motion is held before the first and after the last. Returned
    rotations are at most half a turn long.
    """
    after = np.clip(np.searchsorted(times, wanted, side="right"), 1, max(1, len(times) - 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    span = np.maximum(times[after] - times[before], 1e-12)
    s = np.clip((wanted - times[before]) / span, 0, 1)
    quats = roma.rotvec_to_unitquat(torch.from_numpy(rotations))
    first, second = quats[before], quats[after]
    step = roma.quat_product(roma.quat_conjugation(first), second)
    step = roma.unitquat_to_rotvec(step, shortest_arc=True)
    step = roma.rotvec_to_unitquat(step * torch.from_numpy(s)[:, None, None])
    turned = roma.unitquat_to_rotvec(roma.quat_product(first, step), shortest_arc=True)
    moved = others[before] + s[:, None] * (others[after] - others[before])
    return turned.numpy(), moved


def longest_gap(known: np.ndarray) -> int:
    """Return the length of the longest run of unknown frames; ``known`` is (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
