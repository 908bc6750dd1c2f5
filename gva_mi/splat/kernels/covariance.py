"""The ellipse of a Gaussian whose covariance is given, not its quaternion and scales.

    C = B Sigma B^T + blur I,  B = J R                 replaces eq. 4 and 5 of ellipse.py

There is no cross product as in ellipse.py: the digits that it would save for a needle were already
lost when Sigma was rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels.ellipse import (
    LN2,
    EllipseGradient,
    Factor,
    dot,
    plus,
    product,
    product_adjoint,
)
from gva_mi.splat.kernels.geometry import Covariance
from gva_mi.splat.kernels.lens import Matrix
from gva_mi.splat.options import SplatOptions


def _matrix(geometry: Covariance) -> list[Array]:
    """Sigma, row by row."""
    xx, xy, xz, yy, yz, zz = geometry.covars
    return [xx, xy, xz, xy, yy, yz, xz, yz, zz]


@dataclass(frozen=True)
class CovarianceEllipse:
    """Eq. 6-7 of one Gaussian, with the interface of ``ellipse.Ellipse``."""

    J: Matrix
    R: list[Array]
    o: Array
    blur: Array  # px^2
    B: list[Array]  # 2 x 3
    BS: list[Array]  # B Sigma, 2 x 3
    sharp: list[Array]  # B Sigma B^T: xx, xy, yy
    sharp_det: Array
    C: list[Array]  # c_xx, c_xy, c_yy
    det: Array  # of C
    L: Factor
    lo: Array
    options: SplatOptions

    @staticmethod
    def of(
        J: Matrix,
        R: list[Array],
        geometry: Covariance,
        o: Array,
        blur: Array,
        options: SplatOptions,
    ) -> CovarianceEllipse:
        B = product(J, R)
        BS = product(B, _matrix(geometry))
        xx, xy, yy = dot(BS[:3], B[:3]), dot(BS[:3], B[3:]), dot(BS[3:], B[3:])
        xx, yy = (
            dr.select(v > 0, v, 0) for v in (xx, yy)
        )  # finite even where Sigma is no covariance
        sharp_det = xx * yy - xy * xy
        sharp_det = dr.select(sharp_det > 0, sharp_det, 0)
        C, det = [xx + blur, xy, yy + blur], sharp_det + blur * (xx + yy + blur)
        lo = dr.log2(o)
        if options.antialiased:
            lo += 0.5 * dr.log2(sharp_det / det)
        L, sharp = Factor.of(C, det), [xx, xy, yy]
        return CovarianceEllipse(J, R, o, blur, B, BS, sharp, sharp_det, C, det, L, lo, options)

    def adjoint(self, m0: Array, mxx: Array, mxy: Array, myy: Array) -> EllipseGradient:
        """From the moments: dL/dSigma = B^T dL/dC B and dL/dB = 2 dL/dC B Sigma.

        An off-diagonal number stands for two entries of Sigma and receives both gradients.
        """
        B, BS = self.B, self.BS
        gC = self.L.adjoint(mxx, mxy, myy)
        if self.options.antialiased:
            for (xx, xy, yy), det, sign in (
                (self.C, self.det, -1),
                (self.sharp, self.sharp_det, 1),
            ):
                half = 0.5 * sign * m0 / det
                gC = [gC[0] + half * yy, gC[1] - half * xy, gC[2] + half * xx]
        H = [gC[0] * B[n] + gC[1] * B[3 + n] for n in range(3)]
        H += [gC[1] * B[n] + gC[2] * B[3 + n] for n in range(3)]
        G = lambda j, n: B[j] * H[n] + B[3 + j] * H[3 + n]
        gB = [2 * (gC[0] * BS[n] + gC[1] * BS[3 + n]) for n in range(3)]
        gB += [2 * (gC[1] * BS[n] + gC[2] * BS[3 + n]) for n in range(3)]
        gJ, gR = product_adjoint(gB, self.J, self.R)
        by_sigma = [G(0, 0), 2 * G(0, 1), 2 * G(0, 2), G(1, 1), 2 * G(1, 2), G(2, 2)]
        return EllipseGradient(gJ, gR, Covariance(by_sigma), m0 / self.o)

    def tangent(
        self, dJ: Matrix, dR: list[Array], dgeometry: Covariance, do: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Tangents of p, q, r, lo."""
        B, BS = self.B, self.BS
        dB = [plus(a, b) for a, b in zip(product(dJ, self.R), product(self.J, dR), strict=True)]
        BdS = product(B, _matrix(dgeometry))
        dxx = 2 * dot(dB[:3], BS[:3]) + dot(BdS[:3], B[:3])
        dxy = dot(dB[:3], BS[3:]) + dot(BS[:3], dB[3:]) + dot(BdS[:3], B[3:])
        dyy = 2 * dot(dB[3:], BS[3:]) + dot(BdS[3:], B[3:])
        xx, xy, yy = self.sharp
        dsharp = dxx * yy + xx * dyy - 2 * xy * dxy
        rdet = (dsharp + self.blur * (dxx + dyy)) / self.det  # relative
        dlo = do / self.o
        if self.options.antialiased:
            dlo += 0.5 * (dsharp / self.sharp_det - rdet)
        return *self.L.tangent(dxy, dyy, rdet), dlo / LN2
