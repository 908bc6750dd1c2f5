"""The shape and opacity of a Gaussian in the picture: forward, adjoint, tangent (paper, Eq. 2).

With J of lens.py, the camera's R, and M the rotation of the Gaussian's quaternion:

(4)  V   = B M S,  B = J R                           S = diag(scales)
(5)  C   = V V^T + blur I                            covariance in the picture
(6)  L   = [[p, q], [0, r]],  L^T L = C^-1 / (2 ln 2)
(7)  alpha(d) = o exp(-d^T C^-1 d / 2) = 2^(lo - |L d|^2),  lo = log2(o),  d = pixel centre - u
     antialiased: o sqrt(det(V V^T) / det C) replaces o

Compositing evaluates the factor of eq. 6: |L d|^2 avoids the cancellation in the polynomial
d^T C^-1 d, so a needle of 100 pixels keeps its float32 digits. Base 2 saves a product. To avoid the
same cancellation, determinants use the cross product n = V_x x V_y of V's rows: det(V V^T) = |n|^2,
and det C = |n|^2 + blur (tr V V^T + blur).

If a Gaussian is given by its covariance Sigma instead of its quaternion and scales, eq. 4 and 5
become

     C   = B Sigma B^T + blur I,  B = J R

and no cross product is used: the digits that it would save for a needle were already lost when
Sigma was rounded.

ℓ is the loss. Names that begin with g hold its gradients (gC = dℓ/dC), names that begin with d hold
tangents.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels.inputs import Covariance, Geometry, QuatScale
from gva_mi.splat.kernels.pixel import LN2
from gva_mi.splat.kernels.vectors import (
    Mat3,
    Mat23,
    Quat,
    Sym2,
    Sym3,
    Vec3,
    cross,
    diagonal_product,
    dot,
    each,
    product,
    symmetric_product,
    transposed_product,
)
from gva_mi.splat.options import SplatOptions


@dataclass(frozen=True)
class Factor:
    """Eq. 6: the factor L of an inverse covariance, with its adjoint and tangent."""

    C: Sym2
    det: Array  # of C
    p: Array
    q: Array
    r: Array

    @staticmethod
    def of(C: Sym2, det: Array) -> Factor:
        half = 0.5 / LN2
        p = dr.sqrt(half * C.yy / det)
        return Factor(C, det, p, -p * C.xy / C.yy, dr.sqrt(half / C.yy))

    def adjoint(self, m2: Sym2) -> Sym2:
        """Return dℓ/dC = 2 (ln 2)^2 L^T m2 L, given the moments m2 of eq. 16 (pixel.py)."""
        p, q, r = self.p, self.q, self.r
        k2 = 2 * LN2 * LN2
        m2L_xx, m2L_xy, m2L_yy = m2.xx * p, m2.xx * q + m2.xy * r, m2.xy * q + m2.yy * r
        return Sym2(k2 * p * m2L_xx, k2 * p * m2L_xy, k2 * (q * m2L_xy + r * m2L_yy))

    def tangent(self, dxy: Array, dyy: Array, relative_ddet: Array) -> tuple[Array, Array, Array]:
        """Return the tangents of p, q, r; ``relative_ddet`` is d(det C) / det C."""
        relative_dyy = dyy / self.C.yy
        dp = 0.5 * self.p * (relative_dyy - relative_ddet)
        dq = 0.5 * self.q * (-relative_dyy - relative_ddet) - self.p * dxy / self.C.yy
        return dp, dq, -0.5 * self.r * relative_dyy


def product_adjoint(gB: Mat23, J: Mat23, R: Mat3) -> tuple[Mat23, Mat3]:
    """Return dℓ/dJ = dℓ/dB R^T and dℓ/dR = J^T dℓ/dB, given dℓ/dB of B = J R."""
    return product(gB, R.T), transposed_product(J, gB)


def add_det_adjoint(gC: Sym2, C: Sym2, gdet: Array) -> Sym2:
    """Add to dℓ/dC the part through det C, given gdet = dℓ/d(det C)."""
    return Sym2(gC.xx + gdet * C.yy, gC.xy - gdet * C.xy, gC.yy + gdet * C.xx)


def rotation_matrix(q: Quat) -> Mat3:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return Mat3(
        Vec3(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        Vec3(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        Vec3(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@dataclass(frozen=True)
class Rotation:
    """Rotation matrix of a quaternion of any length; the zero quaternion gives the identity."""

    q: Quat  # unit
    inverse_norm: Array  # 1/|quaternion|
    M: Mat3

    @staticmethod
    def of(quat: Quat) -> Rotation:
        squared = dot(quat, quat)
        inverse_norm = dr.select(squared > 0, 1 / dr.sqrt(squared), 0)
        q = quat * inverse_norm
        return Rotation(q, inverse_norm, rotation_matrix(q))

    def adjoint(self, gM: Mat3) -> Quat:
        """Return dℓ/dquaternion, given dℓ/dM: through the matrix, then the normalisation."""
        w, x, y, z = self.q
        # entries of gM - gM^T and gM + gM^T
        odd_x, odd_y, odd_z = gM.z.y - gM.y.z, gM.x.z - gM.z.x, gM.y.x - gM.x.y
        even_x, even_y, even_z = gM.z.y + gM.y.z, gM.x.z + gM.z.x, gM.y.x + gM.x.y
        gq = Quat(
            2 * (x * odd_x + y * odd_y + z * odd_z),
            2 * (w * odd_x + y * even_z + z * even_y - 2 * x * (gM.y.y + gM.z.z)),
            2 * (w * odd_y + x * even_z + z * even_x - 2 * y * (gM.x.x + gM.z.z)),
            2 * (w * odd_z + x * even_y + y * even_x - 2 * z * (gM.x.x + gM.y.y)),
        )
        radial = dot(self.q, gq)
        return each(lambda g, q: self.inverse_norm * (g - q * radial), gq, self.q)

    def tangent(self, dquat: Quat) -> Mat3:
        """Return the tangent of M, given the quaternion's."""
        w, x, y, z = self.q
        radial = dot(self.q, dquat)
        dw, dx, dy, dz = each(lambda d, q: self.inverse_norm * (d - q * radial), dquat, self.q)
        xy, xz, yz = dx * y + x * dy, dx * z + x * dz, dy * z + y * dz
        wx, wy, wz = dw * x + w * dx, dw * y + w * dy, dw * z + w * dz
        xx, yy, zz = 2 * x * dx, 2 * y * dy, 2 * z * dz
        return Mat3(
            Vec3(-2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)),
            Vec3(2 * (xy + wz), -2 * (xx + zz), 2 * (yz - wx)),
            Vec3(2 * (xz - wy), 2 * (yz + wx), -2 * (xx + yy)),
        )


@dataclass(frozen=True)
class EllipseGradient:
    """Gradients with respect to the inputs of an ellipse."""

    J: Mat23
    R: Mat3
    geometry: Geometry
    o: Array


@dataclass(frozen=True)
class Ellipse:
    """Eq. 4-7 of one Gaussian, with the intermediate values for its adjoint and tangent."""

    J: Mat23
    R: Mat3
    s: Vec3
    o: Array
    blur: Array  # px^2
    rotation: Rotation
    B: Mat23
    BM: Mat23
    V: Mat23
    C: Sym2
    n: Vec3  # V_x x V_y
    unblurred_det: Array  # det(V V^T)
    det: Array  # of C
    L: Factor
    lo: Array
    options: SplatOptions

    @staticmethod
    def of(
        J: Mat23, R: Mat3, geometry: QuatScale, o: Array, blur: Array, options: SplatOptions
    ) -> Ellipse:
        rotation, s = Rotation.of(geometry.quats), geometry.scales
        B = product(J, R)
        BM = product(B, rotation.M)
        V = diagonal_product(BM, s)
        xx, xy, yy = dot(V.x, V.x), dot(V.x, V.y), dot(V.y, V.y)
        C = Sym2(xx + blur, xy, yy + blur)
        n = cross(V.x, V.y)
        unblurred_det = dot(n, n)
        det = unblurred_det + blur * (xx + yy + blur)
        L = Factor.of(C, det)
        lo = dr.log2(o)
        if options.antialiased:
            lo += 0.5 * dr.log2(unblurred_det / det)
        return Ellipse(
            J, R, s, o, blur, rotation, B, BM, V, C, n, unblurred_det, det, L, lo, options
        )

    def adjoint(self, m0: Array, m2: Sym2) -> EllipseGradient:
        """Return the gradients, given the moments of eq. 16 (pixel.py).

        dℓ/dV = 2 dℓ/dC V. Antialiasing adds (ln det(V V^T) - ln det C) / 2 to ln o, where
        d det(V V^T) / dV_x = 2 V_y x n and d det(V V^T) / dV_y = 2 n x V_x.

        Args:
            m0: sum of v over pixels, dℓ/dln o; v = dℓ/dln alpha of one pixel.
            m2: sum of v w w^T over pixels, w = L d.
        """
        V, BM = self.V, self.BM
        gC = self.L.adjoint(m2)
        if self.options.antialiased:
            gC = add_det_adjoint(gC, self.C, -0.5 * m0 / self.det)
        gV = 2 * symmetric_product(gC, V)
        if self.options.antialiased:
            scale = m0 / self.unblurred_det
            half_ddet_dV = Mat23(cross(V.y, self.n), cross(self.n, V.x))
            gV = each(lambda a, b: a + scale * b, gV, half_ddet_dV)
        gs = Vec3(*(dot(a, b) for a, b in zip(gV.columns, BM.columns, strict=True)))
        gBM = diagonal_product(gV, self.s)
        gM = transposed_product(self.B, gBM)
        gB = product(gBM, self.rotation.M.T)
        gJ, gR = product_adjoint(gB, self.J, self.R)
        return EllipseGradient(gJ, gR, QuatScale(self.rotation.adjoint(gM), gs), m0 / self.o)

    def tangent(
        self, dJ: Mat23, dR: Mat3, dgeometry: QuatScale, do: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return the tangents of p, q, r, lo."""
        V, dM = self.V, self.rotation.tangent(dgeometry.quats)
        dB = product(dJ, self.R) + product(self.J, dR)
        dBM = product(dB, self.rotation.M) + product(self.B, dM)
        dV = diagonal_product(dBM, self.s) + diagonal_product(self.BM, dgeometry.scales)
        dxx, dyy = 2 * dot(V.x, dV.x), 2 * dot(V.y, dV.y)
        dxy = dot(V.x, dV.y) + dot(V.y, dV.x)
        dn = cross(dV.x, V.y) + cross(V.x, dV.y)
        dunblurred_det = 2 * dot(self.n, dn)
        relative_ddet = (dunblurred_det + self.blur * (dxx + dyy)) / self.det
        dlo = do / self.o
        if self.options.antialiased:
            dlo += 0.5 * (dunblurred_det / self.unblurred_det - relative_ddet)
        return *self.L.tangent(dxy, dyy, relative_ddet), dlo / LN2


@dataclass(frozen=True)
class CovarianceEllipse:
    """Eq. 6-7 of one Gaussian given by its covariance, with the interface of ``Ellipse``."""

    J: Mat23
    R: Mat3
    o: Array
    blur: Array  # px^2
    B: Mat23
    BS: Mat23  # B Sigma
    unblurred: Sym2  # B Sigma B^T
    unblurred_det: Array
    C: Sym2
    det: Array  # of C
    L: Factor
    lo: Array
    options: SplatOptions

    @staticmethod
    def of(
        J: Mat23, R: Mat3, geometry: Covariance, o: Array, blur: Array, options: SplatOptions
    ) -> CovarianceEllipse:
        B = product(J, R)
        BS = product(B, geometry.covars.matrix())
        xx, xy, yy = dot(BS.x, B.x), dot(BS.x, B.y), dot(BS.y, B.y)
        # keep values finite if Sigma is not positive semidefinite
        xx, yy = (dr.select(v > 0, v, 0) for v in (xx, yy))
        unblurred_det = xx * yy - xy * xy
        unblurred_det = dr.select(unblurred_det > 0, unblurred_det, 0)
        C, det = Sym2(xx + blur, xy, yy + blur), unblurred_det + blur * (xx + yy + blur)
        lo = dr.log2(o)
        if options.antialiased:
            lo += 0.5 * dr.log2(unblurred_det / det)
        L, unblurred = Factor.of(C, det), Sym2(xx, xy, yy)
        return CovarianceEllipse(
            J, R, o, blur, B, BS, unblurred, unblurred_det, C, det, L, lo, options
        )

    def adjoint(self, m0: Array, m2: Sym2) -> EllipseGradient:
        """Return dℓ/dSigma = B^T dℓ/dC B and dℓ/dB = 2 dℓ/dC B Sigma, given the moments.

        An off-diagonal number stands for two entries of Sigma and receives both gradients.
        """
        gC = self.L.adjoint(m2)
        if self.options.antialiased:
            gC = add_det_adjoint(gC, self.C, -0.5 * m0 / self.det)
            gC = add_det_adjoint(gC, self.unblurred, 0.5 * m0 / self.unblurred_det)
        gSigma = transposed_product(self.B, symmetric_product(gC, self.B))
        gB = 2 * symmetric_product(gC, self.BS)
        gJ, gR = product_adjoint(gB, self.J, self.R)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = gSigma
        by_covars = Covariance(Sym3(xx, 2 * xy, 2 * xz, yy, 2 * yz, zz))
        return EllipseGradient(gJ, gR, by_covars, m0 / self.o)

    def tangent(
        self, dJ: Mat23, dR: Mat3, dgeometry: Covariance, do: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return the tangents of p, q, r, lo."""
        B, BS = self.B, self.BS
        dB = product(dJ, self.R) + product(self.J, dR)
        BdS = product(B, dgeometry.covars.matrix())
        dxx = 2 * dot(dB.x, BS.x) + dot(BdS.x, B.x)
        dxy = dot(dB.x, BS.y) + dot(BS.x, dB.y) + dot(BdS.x, B.y)
        dyy = 2 * dot(dB.y, BS.y) + dot(BdS.y, B.y)
        xx, xy, yy = self.unblurred
        dunblurred_det = dxx * yy + xx * dyy - 2 * xy * dxy
        relative_ddet = (dunblurred_det + self.blur * (dxx + dyy)) / self.det
        dlo = do / self.o
        if self.options.antialiased:
            dlo += 0.5 * (dunblurred_det / self.unblurred_det - relative_ddet)
        return *self.L.tangent(dxy, dyy, relative_ddet), dlo / LN2
