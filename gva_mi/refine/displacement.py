"""The clothes: one displacement ``D`` of the rest surface that all frames share (SMPL-X + D).

Clothes and hair stand off the body, and no pose of a bare body fills the mask of a clothed person:
limbs, size and depth would change to make up for the cloth. ``D`` (V, 3) costs

    E(D) = a mean |Δ D|² / h⁴ + b mean |D|² + c mean min(D · n, 0)²

with the rest surface's normals ``n``, ``Δ`` a vertex minus the mean of its neighbours, and ``h²``
the mean square of the edges. The energy keeps ``D`` smooth, small, and outward, because cloth lies
on the body. On the hands ``D`` is zero: they are bare, and their pose is found by their shape.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.mesh.surface import uniform_laplacian, vertex_normals
from gva_mi.refine.close_ups import hand_vertices

SMOOTHNESS = 1.6e-4  # a, for one (1/m)²; chosen
# b and c, for one square metre. Chosen: cloth may stand off by decimetres, and hardly enters.
SMALLNESS, OUTWARDNESS = 10.0, 400.0


class Displacement:
    """The displacement ``D`` and its energy.

    ``raw`` (V, 3) is the leaf that an optimiser may move; ``D`` equals it, but is zero on the
    hands.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, weights: Tensor) -> None:
        """Start at zero on a rest surface (V, 3), metres, with skinning weights (V, 55)."""
        exact = vertex_normals(vertices.detach().double(), faces)
        self._normals = exact.to(vertices.dtype)
        ends = vertices[faces], vertices[faces.roll(1, dims=1)]
        self._square_edge = float((ends[0] - ends[1]).square().sum(-1).mean())
        self._laplacian = uniform_laplacian(faces.numpy(), len(vertices))
        self._free = (~hand_vertices(weights)).to(vertices.dtype)[:, None]
        self.raw = torch.zeros_like(vertices).requires_grad_()

    @property
    def offsets(self) -> Tensor:
        """``D`` (V, 3), metres."""
        return self.raw * self._free

    def energy(self, offsets: Tensor) -> Tensor:
        """Return ``E(D)``."""
        bent = torch.sparse.mm(self._laplacian, offsets).square().sum() / self._square_edge**2
        inward = (offsets * self._normals).sum(1).clamp_max(0).square().sum()
        total = SMOOTHNESS * bent + SMALLNESS * offsets.square().sum() + OUTWARDNESS * inward
        return total / len(offsets)
