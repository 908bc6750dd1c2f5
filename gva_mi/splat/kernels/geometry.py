"""The two forms of a Gaussian's covariance: a quaternion with scales, or the matrix itself.

Each form is a record that exists twice: in memory its fields are flat arrays of all Gaussians, and
in a kernel they are lists of columns, one Gaussian per SIMD lane. Gradients and tangents have the
same form as the Gaussians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets

Columns = Callable[[list[Array]], list[Array]]


@dataclass(frozen=True)
class QuatScale:
    """Sigma = M S S M^T, with the rotation M of a quaternion and S = diag(scales)."""

    quats: Any  # 4 N numbers wxyz; in a kernel 4 columns
    scales: Any  # 3 N numbers, metres; in a kernel 3 columns

    @staticmethod
    def empty(F: type, n: int) -> QuatScale:
        """Allocate memory for n Gaussians, inside a frozen kernel."""
        return QuatScale(dr.empty(F, 4 * n), dr.empty(F, 3 * n))

    def load(self, i: Array) -> QuatScale:
        """Read the columns of the Gaussians ``i``."""
        F = type(self.scales)
        scales = [dr.gather(F, self.scales, 3 * i + k) for k in range(3)]
        return QuatScale(packets.load_rows(self.quats, 4, i), scales)

    def store(self, columns: QuatScale, i: Array) -> None:
        """Write columns to the Gaussians ``i``."""
        for k in range(3):
            mode = dr.ReduceMode.NoConflicts
            dr.scatter(self.scales, columns.scales[k], 3 * i + k, mode=mode)
        packets.store_rows(self.quats, columns.quats, i)

    def columns(self) -> list[Array]:
        """All columns, in a kernel."""
        return [*self.quats, *self.scales]

    def map(self, function: Columns) -> QuatScale:
        """Apply a function to each list of columns."""
        return QuatScale(function(self.quats), function(self.scales))


@dataclass(frozen=True)
class Covariance:
    """Sigma by its upper triangle: xx, xy, xz, yy, yz, zz."""

    covars: Any  # 6 N numbers, square metres; in a kernel 6 columns

    @staticmethod
    def empty(F: type, n: int) -> Covariance:
        """Allocate memory for n Gaussians, inside a frozen kernel."""
        return Covariance(dr.empty(F, 6 * n))

    def load(self, i: Array) -> Covariance:
        """Read the columns of the Gaussians ``i``."""
        return Covariance(packets.load_rows(self.covars, 6, i))

    def store(self, columns: Covariance, i: Array) -> None:
        """Write columns to the Gaussians ``i``."""
        packets.store_rows(self.covars, columns.covars, i)

    def columns(self) -> list[Array]:
        """All columns, in a kernel."""
        return list(self.covars)

    def map(self, function: Columns) -> Covariance:
        """Apply a function to the list of columns."""
        return Covariance(function(self.covars))


Geometry = QuatScale | Covariance
