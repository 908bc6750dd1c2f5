"""Triangle meshes: vertex normals, the uniform Laplacian, and a body with fewer triangles.

* ``n_v = Σ_f c_f / |Σ_f c_f|`` over the faces at vertex ``v``, with ``c_f`` the cross product of
  two sides of face ``f``: normals weighted by area (Gouraud, "Continuous Shading of Curved
  Surfaces", 1971).
* ``(Δ x)_v = x_v - mean of x over the neighbours of v``: the uniform Laplacian (Taubin, "A Signal
  Processing Approach to Fair Surface Design", 1995).

Fewer triangles more than halve the time of a step: Mitsuba rebuilds its ray-tracing tree for every
pose, and every vertex is posed. At the compared size a pixel is 8 mm wide and holds several
triangles of a body of 20,000, so a sixth of them draws nearly the same image.

Edges are collapsed onto one of their ends by the quadric error of Garland and Heckbert ("Surface
Simplification Using Quadric Error Metrics", 1997), so the remaining vertices keep their own blend
shapes and weights. Where close-ups show hands and feet at several
times the person's scale, hands keep a fifth of their triangles, and feet half.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# w of eq. 1, agreement on the kept vertices against smoothness. Chosen: large beside the entries of
# the Laplacian, which are about 1, so that kept vertices hardly leave their offsets.
DATA_WEIGHT = 1e3


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Return unit normals (V, 3), averaged over the faces (F, 3) around each vertex by area.

    They are computed in the precision of the vertices.

    Example:
        >>> faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> vertices = torch.cat([torch.zeros(1, 3), torch.eye(3)])  # of a tetrahedron
        >>> vertex_normals(vertices, faces)[0]
        tensor([-0.5774, -0.5774, -0.5774])
    """
    a, b, c = vertices[faces].unbind(1)
    crossed = torch.linalg.cross(b - a, c - a)
    corners = faces.T.flatten()
    total = lambda along: torch.bincount(corners, along.repeat(3), len(vertices))
    summed = [total(along) for along in crossed.unbind(1)]
    return torch.nn.functional.normalize(torch.stack(summed, -1).to(vertices.dtype), dim=-1)


def uniform_laplacian(faces: np.ndarray, count: int) -> Tensor:
    """Return the Laplacian of ``count`` vertices, (V, V) float32: each minus its neighbours' mean.

    The row of a vertex without neighbours is zero. The matrix is in torch's coordinate format,
    whose products add in a fixed order.

    Example:
        >>> uniform_laplacian(np.array([[0, 1, 2]]), count=4).to_dense()
        tensor([[ 1.0000, -0.5000, -0.5000,  0.0000],
                [-0.5000,  1.0000, -0.5000,  0.0000],
                [-0.5000, -0.5000,  1.0000,  0.0000],
                [ 0.0000,  0.0000,  0.0000,  0.0000]])
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
    """Convert a coalesced sparse matrix of torch to a float64 matrix of SciPy.

    Example:
        >>> as_scipy(uniform_laplacian(np.array([[0, 1, 2]]), count=3)).dtype
        dtype('float64')
    """
    from scipy.sparse import coo_array

    values, index = sparse.values().double().numpy(), tuple(sparse.indices().numpy())
    return coo_array((values, index), sparse.shape).tocsr()


class CoarseBody:
    """A body on some of its vertices.

    Attributes:
        whole: the body.
        body: the body on the n vertices that were kept.
        kept: (n,) their numbers in the whole body.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> coarse = CoarseBody(load_body(), faces=2000)
        >>> coarse.body.faces.shape
        torch.Size([2000, 3])
        >>> moved = torch.ones(len(coarse.kept), 3)
        >>> coarse.spread(moved).mean()  # the whole body moves with the kept vertices
        tensor(1.)
    """

    def __init__(self, whole: BodyModel, faces: int, finer: Tensor | None = None) -> None:
        """Simplify the mean person to ``faces`` faces, if it has more.

        ``finer`` (n,) are numbers of the vertices that close-ups show; None: no close-ups.
        """
        self.whole = whole
        if len(whole.faces) <= faces:
            self.kept = torch.arange(len(whole.v_template))
            self.body = whole
        else:
            self.kept, triangles = collapse(whole.v_template, whole.faces, faces, finer)
            self.body = whole.on(self.kept, triangles)

    def spread(self, offsets: Tensor) -> Tensor:
        """Extend a displacement of the coarse body (n, 3) to the whole body (V, 3).

        The result is the smoothest displacement that agrees on the kept vertices:

        1. ``argmin_D |Δ D|² + w |D_kept - offsets|²``
        """
        count = len(self.whole.v_template)
        if len(self.kept) == count:
            return offsets
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        bending = as_scipy(uniform_laplacian(self.whole.faces.numpy(), count))
        weights, pulled = np.zeros(count), np.zeros((count, 3))
        weights[self.kept], pulled[self.kept] = DATA_WEIGHT, DATA_WEIGHT * offsets.double().numpy()
        solved = splu((bending.T @ bending + diags_array(weights)).tocsc()).solve(pulled)
        return torch.from_numpy(solved).to(offsets.dtype)


def collapse(
    vertices: Tensor, faces: Tensor, count: int, finer: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Return numbers (n,) of the kept vertices, and the triangles (count, 3) between them.

    More are kept around the vertices ``finer`` (n,); None: all are alike.

    Example:
        >>> y, x = torch.meshgrid(torch.arange(5), torch.arange(5), indexing="ij")
        >>> grid = torch.stack([x, y, 0 * x], -1).reshape(-1, 3).float()  # a flat square
        >>> corner = (y * 5 + x)[:-1, :-1].reshape(-1, 1)
        >>> faces = torch.cat([corner + torch.tensor([0, 1, 6]), corner + torch.tensor([0, 6, 5])])
        >>> kept, triangles = collapse(grid, faces, count=8)
        >>> len(faces), len(triangles)
        (32, 8)
    """
    import pymeshlab
    from scipy.spatial import cKDTree

    points = vertices.double().numpy()
    meshes = pymeshlab.MeshSet()
    quality = np.zeros(len(points))  # pymeshlab rescales qualities: only their order counts
    if finer is not None:
        quality[finer.numpy()] = 1
    meshes.add_mesh(pymeshlab.Mesh(points, faces.numpy(), v_scalar_array=quality))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=count,
        optimalplacement=False,
        preservetopology=True,
        preservenormal=True,
        qualityweight=finer is not None,
    )
    left = meshes.current_mesh()
    kept = cKDTree(points).query(left.vertex_matrix())[1]
    return torch.from_numpy(kept), torch.from_numpy(left.face_matrix().astype(np.int64))
