"""Shading normals and depths from positions: forward, tangent and adjoint.

With corners ``p_0, p_1, p_2`` of face ``f`` and the corners that share a normal ``v``:

1. face normal      ``c_f = (p_1 - p_0) x (p_2 - p_0)``, as long as twice the area,
2. shading normal   ``n_v = ± Σ_f c_f / |Σ_f c_f|`` over the faces at ``v``: weighted by area
   (Gouraud, "Continuous Shading of Curved Surfaces", 1971),
3. on a ray         ``n = Σ_k b_k n_k / |Σ_k b_k n_k|`` with the barycentric coordinates ``b`` of
   the hit, ``o + t d = Σ_k b_k p_k`` (Phong, "Illumination for Computer Generated Pictures", 1975).

Every sum runs over fixed lists in a fixed order (``segment_sums.py``); no step adds with
atomics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np
from gva_mi_plugins.mesh_normals.segment_sums import sum_by_key
from gva_mi_plugins.mesh_normals.topology import AREA_ROUNDING, SMALLEST_LENGTH, Topology


@dataclass(frozen=True)
class MeshSurface:
    """Meshes with the positions of their vertices, and the normals that follow from them.

    Example:
        The sides of a cube of 2 m, two triangles each, of 2 m².

        >>> scene = {"type": "scene", "cube": {"type": "cube"}, "sensor": {"type": "perspective"}}
        >>> scene = mi.load_dict(scene)
        >>> integrator = mi.load_dict({"type": "mesh_normals"})
        >>> surface = integrator.view(scene, scene.sensors()[0]).surface
        >>> dr.norm(surface.face_normals)[0] / 2, dr.norm(surface.normals)[0]
        (2.0, 1.0)
    """

    topology: Topology
    positions: mi.Vector3f  # (V,) world
    face_normals: mi.Vector3f  # (F,) c_f, not normalised

    @staticmethod
    def of(topology: Topology, positions: mi.Vector3f) -> MeshSurface:
        """Compute the face normals (eq. 1)."""
        p = [dr.gather(mi.Vector3f, positions, vertex) for vertex in topology.vertices]
        face_normals = dr.cross(p[1] - p[0], p[2] - p[0])
        dr.eval(face_normals)
        return MeshSurface(topology, positions, face_normals)

    @property
    def normals(self) -> mi.Vector3f:
        """``n_v`` (N,), eq. 2."""
        return self._shading[0]

    @property
    def inverse_length(self) -> mi.Float:
        """``± 1 / |Σ c_f|`` (N,)."""
        return self._shading[1]

    @cached_property
    def _shading(self) -> tuple[mi.Vector3f, mi.Float]:
        """Return normals and inverse lengths, computed when first used: a mask needs none."""
        total = self.topology.faces_of_normal.sum(self.face_normals)
        inverse_length = dr.rcp(dr.maximum(dr.norm(total), SMALLEST_LENGTH))
        inverse_length = dr.select(self.topology.flips, -inverse_length, inverse_length)
        normals = total * inverse_length
        dr.eval(normals, inverse_length)
        return normals, inverse_length

    @property
    def corners(self) -> list[mi.Vector3f]:
        """Return the corners of all faces, three (F,) world."""
        return self._at_corners(self.positions)

    def vertices_of(self, face: mi.UInt32, active: mi.Bool = True) -> list[mi.UInt32]:
        """Return the vertices of the given faces, three (S,)."""
        return [dr.gather(mi.UInt32, vertex, face, active) for vertex in self.topology.vertices]

    def corners_of(self, face: mi.UInt32, active: mi.Bool = True) -> list[mi.Vector3f]:
        """Return the corners of the given faces, three (S,) world."""
        vertices = self.vertices_of(face, active)
        return [dr.gather(mi.Vector3f, self.positions, i, active) for i in vertices]

    def flat_faces(self) -> np.ndarray:
        """Return the numbers of the faces without area, most often none."""
        p = self.corners
        side = dr.maximum(dr.norm(p[1] - p[0]), dr.norm(p[2] - p[0]))
        side = dr.maximum(side, dr.norm(p[2] - p[1]))
        reach = [dr.max(dr.abs(corner)) for corner in p]
        least = AREA_ROUNDING * side * dr.maximum(dr.maximum(reach[0], reach[1]), reach[2])
        return np.array(dr.compress(dr.norm(self.face_normals) <= least)).astype(np.int64)

    def longest_sides(self, flat: np.ndarray) -> np.ndarray:
        """Return the longest sides of faces that have three corners, longest first."""
        if len(flat) == 0:
            return flat
        points = np.stack([np.array(point)[flat] for point in self.topology.points], axis=1)
        three = (points != np.roll(points, 1, axis=1)).all(1)
        corners = np.array(self.positions).T[points[three]]
        length = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        order = np.argsort(-length.max(1), kind="stable")
        return (3 * flat[three] + length.argmax(1))[order]

    @cached_property
    def is_solid(self) -> bool:
        """Return whether all meshes are closed and wound outward: no volume is negative."""
        if not self.topology.is_closed:
            return False
        from_origin = np.array(dr.dot(self.corners[0], self.face_normals), np.float64)
        ends = np.cumsum([len(mesh.faces) for mesh in self.topology.welds])
        return all(volumes.sum() >= 0 for volumes in np.split(from_origin, ends))

    def tangent(self, d_positions: mi.Vector3f) -> mi.Vector3f:
        """Return the motion of the shading normals (N,) as positions (V,) move (eq. 1, 2)."""
        p, dp = self.corners, self._at_corners(d_positions)
        dc = dr.cross(dp[1] - dp[0], p[2] - p[0]) + dr.cross(p[1] - p[0], dp[2] - dp[0])
        dr.eval(dc)
        d_total = self.topology.faces_of_normal.sum(dc)
        return self._tangential(d_total)

    def adjoint(self, grad_corners: mi.Vector3f, grad_corner_normals: mi.Vector3f) -> mi.Vector3f:
        """Return the gradient with respect to the positions (V,) (eq. 1 and 2 backward).

        The inputs are gradients of the positions and of the normals of all corners, (3F,).
        """
        topology = self.topology
        grad_total = self._tangential(topology.corners_of_normal.sum(grad_corner_normals))
        dr.eval(grad_total)
        grad_c = sum(dr.gather(mi.Vector3f, grad_total, normal) for normal in topology.normals)
        p = self.corners
        grad_1 = dr.cross(p[2] - p[0], grad_c)
        grad_2 = dr.cross(grad_c, p[1] - p[0])
        face = dr.arange(mi.UInt32, topology.face_count)
        for k, grad in enumerate((-grad_1 - grad_2, grad_1, grad_2)):
            dr.scatter_add(grad_corners, grad, 3 * face + k, mode=dr.ReduceMode.NoConflicts)
        dr.eval(grad_corners)
        return topology.corners_of_vertex.sum(grad_corners)

    def shade(
        self, ray: mi.Ray3f, face: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Return unit normals and ray parameters t (R,) where rays meet faces (eq. 3).

        Both are zero where not active.
        """
        n, t = _interpolate(ray, *self._at(face, active))
        return dr.select(active, n, 0), dr.select(active, t, 0)

    def shade_tangent(
        self, ray: mi.Ray3f, face: mi.UInt32, d_positions: mi.Vector3f, d_normals: mi.Vector3f
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Evaluate eq. 3 forward, for rays that all hit."""
        leaves = self._at(face, True)
        tangents = [dr.gather(mi.Vector3f, d_positions, i) for i in self.vertices_of(face)]
        tangents += [dr.gather(mi.Vector3f, d_normals, i) for i in self._normals(face)]
        with dr.isolate_grad(), dr.resume_grad():
            dr.enable_grad(leaves)
            for leaf, tangent in zip(leaves, tangents, strict=True):
                dr.set_grad(leaf, tangent)
            return dr.forward_to(_interpolate(ray, *leaves))

    def shade_adjoint(
        self, ray: mi.Ray3f, face: mi.UInt32, grad_n: mi.Vector3f | None, grad_t: mi.Float | None
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Evaluate eq. 3 backward, for rays (R,) that all hit.

        Args:
            ray, face: the rays, and the faces that they hit.
            grad_n, grad_t: gradients of normals and ray parameters; None for zero.

        Returns:
            Gradients of the positions and of the shading normals of all corners, (3F,) each.
        """
        leaves = self._at(face, True)
        with dr.isolate_grad(), dr.resume_grad():
            dr.enable_grad(leaves)
            n, t = _interpolate(ray, *leaves)
            terms = [] if grad_n is None else [dr.dot(n, grad_n)]
            terms += [] if grad_t is None else [t * grad_t]
            dr.backward(sum(terms))
            grads = dr.grad(leaves)
        dr.eval(grads)
        sums, faces = sum_by_key(grads, face)
        by_corner = [dr.zeros(mi.Vector3f, 3 * self.topology.face_count) for _ in range(2)]
        for k, value in enumerate(sums):
            dr.scatter(by_corner[k // 3], value, 3 * faces + k % 3)
        dr.eval(by_corner)
        return tuple(by_corner)

    def _tangential(self, x: mi.Vector3f) -> mi.Vector3f:
        """Apply the derivative of eq. 2's normalisation, ``± (I - n nᵀ) / |Σ c_f|``: symmetric."""
        return (x - self.normals * dr.dot(self.normals, x)) * self.inverse_length

    def _at_corners(self, values: mi.Vector3f) -> list[mi.Vector3f]:
        return [dr.gather(mi.Vector3f, values, vertex) for vertex in self.topology.vertices]

    def _normals(self, face: mi.UInt32, active: mi.Bool = True) -> list[mi.UInt32]:
        return [dr.gather(mi.UInt32, normal, face, active) for normal in self.topology.normals]

    def _at(self, face: mi.UInt32, active: mi.Bool) -> list[mi.Vector3f]:
        """Return corners and shading normals of the given faces: p_0, p_1, p_2, n_0, n_1, n_2."""
        n = [dr.gather(mi.Vector3f, self.normals, i, active) for i in self._normals(face, active)]
        return self.corners_of(face, active) + n


def _interpolate(
    ray: mi.Ray3f,
    p0: mi.Vector3f,
    p1: mi.Vector3f,
    p2: mi.Vector3f,
    n0: mi.Vector3f,
    n1: mi.Vector3f,
    n2: mi.Vector3f,
) -> tuple[mi.Vector3f, mi.Float]:
    """Return the normal and the ray's parameter where a ray meets a triangle's plane (eq. 3)."""
    b1, b2, t = meet_plane(ray, p0, p1, p2)
    n = (1 - b1 - b2) * n0 + b1 * n1 + b2 * n2
    return n / dr.norm(n), t


def meet_plane(
    ray: mi.Ray3f, p0: mi.Vector3f, p1: mi.Vector3f, p2: mi.Vector3f
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Solve ``o + t d = p_0 + b_1 (p_1 - p_0) + b_2 (p_2 - p_0)`` for ``b_1, b_2, t``.

    By Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.

    Example:
        >>> ray = mi.Ray3f([0.25, 0.5, -2], [0, 0, 1])
        >>> meet_plane(ray, *map(mi.Vector3f, ([0, 0, 0], [1, 0, 0], [0, 1, 0])))
        ([0.25], [0.5], [2])
    """
    e1, e2, s = p1 - p0, p2 - p0, mi.Vector3f(ray.o) - p0
    h, k = dr.cross(ray.d, e2), dr.cross(s, e1)
    det = dr.dot(e1, h)
    return dr.dot(s, h) / det, dr.dot(ray.d, k) / det, dr.dot(e2, k) / det
