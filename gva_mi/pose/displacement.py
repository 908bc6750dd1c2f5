"""The surface that is seen: the body's rest surface, displaced (SMPL-X + D).

Clothes and hair stand off the body, and no pose of a bare body fills the mask of a clothed person: without a word for
them, limbs, size and depth pay for the cloth. One displacement ``D`` (V, 3) of the rest surface, shared by all
frames, is that word. What it may look like is an energy, in which ``n`` are the rest surface's normals:

    E(D) = a mean |Δ D|² + b mean |D|² + c mean min(D · n, 0)²

smooth (Δ: vertex minus the mean of its neighbours), small, and outward: cloth lies on the body, not in it. On the
hands ``D`` is zero: they are bare, and their shape is what tells their pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND

_WRISTS = [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]


class Displacement:
    """``D`` and its energy; ``D`` is a leaf that an optimiser may move."""

    def __init__(self, vertices: Tensor, faces: Tensor, weights: Tensor) -> None:
        """No displacement yet.

        Args:
            vertices: (V, 3) the rest surface, metres.
            faces: (F, 3).
            weights: (V, 55) skinning weights, which tell where the hands are.
        """
        self._normals = vertex_normals(vertices, faces)
        self._laplacian = _SparseMatrix(_uniform_laplacian(faces.numpy(), len(vertices)))
        self._free = (~hand_vertices(weights)).to(vertices.dtype)[:, None]
        self.raw = torch.zeros_like(vertices).requires_grad_()

    @property
    def offsets(self) -> Tensor:
        """``D`` (V, 3), metres."""
        return self.raw * self._free

    def energy(self, offsets: Tensor, smooth: float, small: float, outward: float) -> Tensor:
        """``E(D)`` with weights a, b, c, each for one square metre."""
        bent = self._laplacian(offsets).square().sum()
        inward = (offsets * self._normals).sum(1).clamp_max(0).square().sum()
        total = smooth * bent + small * offsets.square().sum() + outward * inward
        return total / len(offsets)


def hand_vertices(weights: Tensor) -> Tensor:
    """Which vertices (V,) belong to the hands: more than half moved by the wrists and the fingers."""
    hands = weights[:, LEFT_HAND].sum(1) + weights[:, RIGHT_HAND].sum(1)
    return hands + weights[:, _WRISTS].sum(1) > 0.5


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals (V, 3), averaged from the faces by area."""
    p = vertices.detach().numpy().astype(np.float64)[faces.numpy()]
    face_normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    corners = faces.numpy().reshape(-1)
    total = np.stack(
        [np.bincount(corners, np.repeat(face_normals[:, k], 3), len(vertices)) for k in range(3)], 1
    )
    return torch.nn.functional.normalize(torch.from_numpy(total), dim=1).to(vertices.dtype)


def _uniform_laplacian(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """(V, V): a vertex minus the mean of its neighbours; zero for a vertex without any."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    rows, columns = np.concatenate([sides, sides[:, ::-1]]).T
    adjacency = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    adjacency.data[:] = 1
    degree = np.asarray(adjacency.sum(1)).ravel()
    means = sparse.diags(1 / np.maximum(degree, 1)) @ adjacency
    return (sparse.diags((degree > 0).astype(float)) - means).tocsr()


class _SparseMatrix:
    """A constant sparse matrix times a dense one; the adjoint multiplies by the transpose, row by row.

    torch's own backward of the same product scatters, in an order that depends on the threads.
    """

    def __init__(self, matrix: sparse.csr_matrix) -> None:
        self.forward, self.transposed = _torch_csr(matrix), _torch_csr(matrix.T.tocsr())

    def __call__(self, x: Tensor) -> Tensor:
        return _Multiply.apply(x, self)


class _Multiply(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, matrix: _SparseMatrix) -> Tensor:
        ctx.matrix = matrix
        return matrix.forward @ x

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        return ctx.matrix.transposed @ grad.contiguous(), None


def _torch_csr(matrix: sparse.csr_matrix) -> Tensor:
    return torch.sparse_csr_tensor(
        torch.from_numpy(matrix.indptr.astype(np.int64)),
        torch.from_numpy(matrix.indices.astype(np.int64)),
        torch.from_numpy(matrix.data.astype(np.float32)),
        matrix.shape,
        check_invariants=False,
    )
