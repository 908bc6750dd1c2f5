"""Vertex normals and the uniform Laplacian of a triangle mesh.

* ``n_v = Σ_f c_f / |Σ_f c_f|`` over the faces at vertex ``v``, with ``c_f`` the cross product of
  two sides of face ``f``: normals weighted by area.
* ``(Δ x)_v = x_v - mean of x over the neighbours of v``: the uniform Laplacian.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Return unit normals (V, 3), averaged over the faces (F, 3) around each vertex by area.

    They are computed in the precision of the vertices.
    """
    a, b, c = vertices[faces].unbind(1)
    crossed = torch.linalg.cross(b - a, c - a)
    corners = faces.T.flatten()
    summed = [
        torch.bincount(corners, along.repeat(3), len(vertices)) for along in crossed.unbind(1)
    ]
    return torch.nn.functional.normalize(torch.stack(summed, -1).to(vertices.dtype), dim=-1)


def uniform_laplacian(faces: np.ndarray, count: int) -> Tensor:
    """Return the Laplacian of ``count`` vertices, (V, V) float32: each minus its neighbours' mean.

    Zero where a vertex has none. In torch's coordinate format, whose products add in a fixed order.
    """
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    rows, columns = np.unique(np.concatenate([sides, sides[:, ::-1]]), axis=0).T
    degree = np.bincount(rows, minlength=count)
    used = np.flatnonzero(degree)
    index = np.stack([np.concatenate([used, rows]), np.concatenate([used, columns])])
    values = np.concatenate([np.ones(len(used)), -1 / degree[rows]]).astype(np.float32)
    entries = torch.from_numpy(index), torch.from_numpy(values)
    return torch.sparse_coo_tensor(*entries, (count, count), check_invariants=False).coalesce()


def as_scipy(sparse: Tensor) -> csr_array:
    """Return a coalesced sparse matrix of torch as float64 of SciPy, which solves equations."""
    from scipy.sparse import coo_array

    values, index = sparse.values().double().numpy(), tuple(sparse.indices().numpy())
    return coo_array((values, index), sparse.shape).tocsr()
