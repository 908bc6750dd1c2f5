"""Conversion of Mitsuba's ``ellipsoids`` to the Gaussians of ``gva_mi.splat``, differentiable.

| what | in the shape | in the kernels |
|---|---|---|
| center, scale, rotation | ``data``, ten floats each: 3, 3, 4 | ``means, scales, quats`` |
| rotation | unit quaternion xyzw | wxyz, normalised inside |
| scale | standard deviations along its axes | the same |
| opacity at the center | ``opacities`` (N, 1) | ``opacities`` (N,) |
| colour | ``sh_coeffs`` (N, 3 K), coefficient by coefficient | ``sh`` (N, K, 3), the same basis |

The shape's ``extent`` limits an ellipsoid for ray tracers; a splat ends where its alpha falls to
1/255.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gva_mi.splat import Gaussians
from gva_mi.splat.gaussians import MAX_DEGREE, degree_of
from gva_mi.splat.kernels import sh

DATA = 10  # floats of an ellipsoid in ``data``
COEFFICIENTS = [(degree + 1) ** 2 for degree in range(MAX_DEGREE + 1)]


def gaussians_of(scene: mi.Scene) -> Gaussians:
    """Collect all ellipsoids of a scene, attached to the shapes' parameters.

    Raises:
        ValueError: there is no ellipsoid, or an attribute is missing or has the wrong size.
    """
    parts = [_Ellipsoids.of(shape) for shape in scene.shapes() if shape.is_ellipsoids()]
    if not parts:
        raise ValueError("gaussian_splat: the scene has no shape of type 'ellipsoids'")
    n, K = sum(part.count for part in parts), max(part.coefficients for part in parts)
    joined = lambda arrays: arrays[0] if len(arrays) == 1 else dr.concat(arrays)
    return Gaussians(
        means=mi.TensorXf(joined([part.columns(0, 1, 2) for part in parts]), (n, 3)),
        quats=mi.TensorXf(joined([part.columns(9, 6, 7, 8) for part in parts]), (n, 4)),
        scales=mi.TensorXf(joined([part.columns(3, 4, 5) for part in parts]), (n, 3)),
        opacities=mi.TensorXf(joined([part.opacities for part in parts]), (n,)),
        sh=mi.TensorXf(joined([part.harmonics(K) for part in parts]), (n, K, 3)),
    )


def seen_along(gaussians: Gaussians, direction: list[mi.Float]) -> Gaussians:
    """Evaluate the colours for parallel rays along a unit vector."""
    n, K, _ = gaussians.sh.shape
    basis = sh.basis(degree_of(K), *direction)
    k = dr.arange(mi.UInt32, 3 * n)
    first = k // 3 * (3 * K) + k % 3
    total = mi.Float(0.5)
    for i in range(K):
        total = total + basis[i] * _gather(gaussians.sh.array, first + 3 * i)
    colors = mi.TensorXf(dr.select(total > 0, total, 0), (n, 3))
    return Gaussians(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, colors
    )


@dataclass(frozen=True)
class _Ellipsoids:
    """Parameters of one shape."""

    data: mi.Float  # 10 N
    opacities: mi.Float  # N
    sh: mi.Float  # 3 K N
    count: int  # N
    coefficients: int  # K

    @staticmethod
    def of(shape: mi.Shape) -> _Ellipsoids:
        parameters = mi.traverse(shape)
        for name, form in (("opacities", "(N, 1)"), ("sh_coeffs", "(N, 3 K)")):
            if name not in parameters:
                raise ValueError(
                    f"gaussian_splat: shape '{shape.id()}' needs the attribute {name} {form}"
                )
        data, opacities, sh = (parameters[name] for name in ("data", "opacities", "sh_coeffs"))
        count = dr.width(data) // DATA
        coefficients, rest = divmod(dr.width(sh), 3 * count)
        if dr.width(opacities) != count:
            raise ValueError(
                f"gaussian_splat: opacities of shape '{shape.id()}' must be (N, 1), got "
                f"{dr.width(opacities)} numbers where N is {count}"
            )
        if rest or coefficients not in COEFFICIENTS:
            raise ValueError(
                f"gaussian_splat: sh_coeffs of shape '{shape.id()}' must be (N, 3 K) with K one of "
                f"{COEFFICIENTS}, got {dr.width(sh)} numbers where N is {count}"
            )
        return _Ellipsoids(data, opacities, sh, count, coefficients)

    def columns(self, *columns: int) -> mi.Float:
        """Select columns of ``data``, as one flat array of rows."""
        width = len(columns)
        k = dr.arange(mi.UInt32, self.count * width)
        column = dr.gather(mi.UInt32, mi.UInt32(columns), k % width)
        return _gather(self.data, k // width * DATA + column)

    def harmonics(self, coefficients: int) -> mi.Float:
        """Pad ``sh`` with zeros to so many coefficients."""
        if coefficients == self.coefficients:
            return self.sh
        wide, own = 3 * coefficients, 3 * self.coefficients
        k = dr.arange(mi.UInt32, self.count * wide)
        return _gather(self.sh, k // wide * own + k % wide, k % wide < own)


def _gather(source: mi.Float, index: mi.UInt32, active: mi.Bool = True) -> mi.Float:
    """Gather from distinct indices, so that the adjoint needs no atomics."""
    return dr.gather(mi.Float, source, index, active=active, mode=dr.ReduceMode.NoConflicts)
