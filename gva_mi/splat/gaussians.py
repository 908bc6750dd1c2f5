"""The records of splatting: what goes in, and what comes out.

Both hold arrays of any one kind (Dr.Jit, torch, numpy): the kernels take Dr.Jit arrays, ``torch_op`` takes
torch tensors. Quaternions are wxyz and need not be normalised; scales are metres, not logarithms; opacities lie
in [0, 1], not logits; colours are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Gaussians:
    """N anisotropic 3D Gaussians with a colour each, plain or in spherical harmonics (one of the two)."""

    means: Any  # (N, 3) metres, world
    quats: Any  # (N, 4) wxyz, normalised inside
    scales: Any  # (N, 3) metres, standard deviations along the axes of quats
    opacities: Any  # (N,) in [0, 1]
    colors: Any = None  # (N, 3)
    sh: Any = None  # (N, K, 3) coefficients, K = (degree + 1)^2; colour = max(0, sum + 0.5)

    def __post_init__(self) -> None:
        if (self.colors is None) == (self.sh is None):
            raise ValueError("Gaussians: give either colors (N, 3) or sh (N, K, 3)")

    def __len__(self) -> int:
        return int(self.means.shape[0])


@dataclass(frozen=True)
class Image:
    """What a render returns; all three are differentiable."""

    color: Any  # (H, W, 3), background blended in
    alpha: Any  # (H, W) in [0, 1]
    depth: (
        Any  # (H, W) metres along the camera's z, accumulated like a colour: sum of T_i alpha_i z_i
    )
