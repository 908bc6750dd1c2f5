"""The body on fewer triangles, on which refining a pose costs less than half.

A quarter of the triangles draw the same picture: at the size that is compared a pixel is 8 mm wide,
and holds several triangles of the body. What takes the time of a step grows with them: the tree in
which Mitsuba finds what a ray hits is built anew for every pose, and vertices are bent and skinned.

Edges are collapsed onto one of their ends in the order of Garland and Heckbert's quadric error, so
that the vertices that are left are vertices of the body, with their own directions and weights.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.surface import uniform_laplacian

AGREE = 1e3  # how much more the displacement of a common vertex counts than a bend


class CoarseBody:
    """Some vertices of a body.

    Attributes:
        body: the body on them.
        kept: (n,) which of the whole body's they are.
    """

    def __init__(self, whole: BodyModel, faces: int) -> None:
        """Simplify the mean person.

        Args:
            whole: the body.
            faces: how many triangles are left; a body that has no more stays as it is.
        """
        self._faces, self._count = whole.faces, len(whole.v_template)
        if len(whole.faces) <= faces:
            self.kept = torch.arange(self._count)
            self.body = whole
        else:
            self.kept, triangles = _collapse(whole.v_template, whole.faces, faces)
            self.body = whole.on(self.kept, triangles)

    def spread(self, offsets: Tensor) -> Tensor:
        """A displacement of the coarse body (n, 3), on the whole one (V, 3).

        The least bent one that agrees with it: ``argmin |Δ D|² + w |D_kept - offsets|²``.
        """
        if len(self.kept) == self._count:
            return offsets
        from scipy.sparse import coo_matrix, diags
        from scipy.sparse.linalg import splu

        laplacian = uniform_laplacian(self._faces.numpy(), self._count)
        index, values = laplacian.indices().numpy(), laplacian.values().double().numpy()
        bend = coo_matrix((values, index), (self._count, self._count)).tocsc()
        weights, pulled = np.zeros(self._count), np.zeros((self._count, 3))
        weights[self.kept], pulled[self.kept] = AGREE, AGREE * offsets.double().numpy()
        solved = splu((bend.T @ bend + diags(weights)).tocsc()).solve(pulled)
        return torch.from_numpy(solved).to(offsets.dtype)


def _collapse(vertices: Tensor, faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Which vertices (n,) are left, and triangles (count, 3) between them."""
    import pymeshlab
    from scipy.spatial import cKDTree

    points = vertices.double().numpy()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, faces.numpy()))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=count, optimalplacement=False, preservetopology=True, preservenormal=True
    )
    left = meshes.current_mesh()
    kept = cKDTree(points).query(left.vertex_matrix())[1]
    return torch.from_numpy(kept), torch.from_numpy(left.face_matrix().astype(np.int64))
