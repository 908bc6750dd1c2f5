"""Secondary motion of cloth and hair: creases at bent joints, and loose ends that lag behind.

At a joint whose rotation bends its bone b (rest pose) by the axis-angle r,

    1. strength  s = |r⊥|² / (|r⊥|² + 0.5²)                r⊥ is r without the twist about b
    2. inside    g = ½ + ½ cos(angle of x about b to r × b)
    3. crease    h = a(x) · window(x) · cos(2π b·(x − J) / 4 cm + phase(x)) · s · g

displaces along the posed normal. Loose ends lag: with p_k the skinned position k steps back and ℓ
the slack, the largest displacement of a vertex,

    4. lag       u = Σ_k w_k p_k − p_0,   displacement ℓ u / √(ℓ² + |u|²),   w_k ~ exp(−k / 2)

Both are smooth in the pose. Creases vanish in the rest pose, lags without motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS

BONES: Mapping[str, str] = {  # joint -> the end of its bone
    "left_elbow": "left_wrist", "right_elbow": "right_wrist", "left_shoulder": "left_elbow",
    "right_shoulder": "right_elbow", "left_knee": "left_ankle", "right_knee": "right_ankle",
    "left_hip": "left_knee", "right_hip": "right_knee", "spine1": "spine2", "spine2": "spine3",
}  # fmt: skip
WAVELENGTH = 0.04  # m, from crease to crease
ALONG, ACROSS = 0.075, 0.15  # m, extent of creases along the bone and across it
HALF = 0.5  # rad, bend at which a crease has half its height
MEMORY = 5  # time steps that a lag depends on
INWARD = 0.6  # fraction removed from a lag into the body


@dataclass(frozen=True)
class Crease:
    """The creases of one joint."""

    joint: int
    bone: np.ndarray  # (3,) unit, rest pose
    index: np.ndarray  # (n,) vertices
    height: np.ndarray  # (n,) metres: a · window · cos of eq. 3
    around: np.ndarray  # (n, 3) unit, from the bone to the vertex

    def displacement(self, rotation: np.ndarray) -> np.ndarray:
        """Return displacements (n,) along the normals, metres, for an axis-angle rotation (3,)."""
        across = rotation - self.bone * (rotation @ self.bone)
        bend = np.linalg.norm(across)
        if bend < 1e-6:
            return np.zeros_like(self.height)
        inner = np.cross(across / bend, self.bone)
        strength = bend**2 / (bend**2 + HALF**2)
        return self.height * strength * (0.5 + 0.5 * (self.around @ inner))


def creases(
    vertices: np.ndarray,
    amplitude: np.ndarray,
    joints: Mapping[str, np.ndarray],
    rng: np.random.Generator,
) -> tuple[Crease, ...]:
    """Place the creases of all joints at random on vertices (N, 3), rest pose, metres.

    Their height is ``amplitude`` (N,), metres; zero where there are none.
    """
    found = []
    cloth = np.flatnonzero(amplitude > 0)
    for name, child in BONES.items():
        bone = joints[child] - joints[name]
        bone = bone / np.linalg.norm(bone)
        away = vertices[cloth] - joints[name]
        along = away @ bone
        radial = away - along[:, None] * bone
        radius = np.linalg.norm(radial, axis=1)
        window = np.exp(-((along / ALONG) ** 2) - (radius / ACROSS) ** 4)
        near = window > 0.02
        slant = rng.normal(0, 22, 3)  # rad/m
        phase = 2 * np.pi * along / WAVELENGTH + away @ slant + rng.uniform(0, 2 * np.pi)
        height = amplitude[cloth] * window * np.cos(phase)
        around = radial / np.maximum(radius, 1e-6)[:, None]
        found.append(Crease(JOINTS.index(name), bone, cloth[near], height[near], around[near]))
    return tuple(found)


def lag(now: np.ndarray, past: np.ndarray, slack: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Return displacements (n, 3) of loose ends (eq. 4), metres.

    ``now`` (n, 3) and ``past`` (MEMORY, n, 3), the latest first, are skinned positions; ``slack``
    (n,) is the largest displacement, metres, and ``away`` (n, 3) points from the body to the
    vertex.
    """
    weights = np.exp(-np.arange(1, MEMORY + 1) / 2)
    behind = np.tensordot(weights / weights.sum(), past, axes=1) - now
    bounded = behind * (slack / np.sqrt(slack**2 + (behind**2).sum(1)))[:, None]
    inward = np.minimum((bounded * away).sum(1), 0)
    return bounded - INWARD * inward[:, None] * away
