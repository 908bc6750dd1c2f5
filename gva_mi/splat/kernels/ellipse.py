"""The shape and opacity of a Gaussian in the picture: forward, adjoint, tangent (paper, Eq. 2).

With J of lens.py, the camera's R, and M the rotation of the Gaussian's quaternion:

(4)  V   = B M S,  B = J R                           S = diag(scales)
(5)  C   = V V^T + blur I                            covariance in the picture
(6)  L   = [[p, q], [0, r]],  L^T L = C^-1 / (2 ln 2)
(7)  alpha(d) = o exp(-d^T C^-1 d / 2) = 2^(lo - |L d|^2),  lo = log2(o),  d = pixel centre - u
     antialiased: o sqrt(det(V V^T) / det C) replaces o

Compositing evaluates the factor of eq. 6: it has one square less to cancel than the polynomial in
d, so a needle of 100 pixels keeps its float32 digits. Base 2 saves a product. For the same reason
determinants come from n = V_0 x V_1, the cross product of V's rows: det(V V^T) = |n|^2, and
det C = |n|^2 + blur (tr V V^T + blur).

Where a covariance Sigma is given, and not its quaternion and scales,

     C   = B Sigma B^T + blur I,  B = J R            replaces eq. 4 and 5

without a cross product: the digits that it would save for a needle were already lost when Sigma was
rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.kernels.inputs import Covariance, Geometry, QuatScale
from gva_mi.splat.kernels.lens import Matrix
from gva_mi.splat.options import SplatOptions

LN2 = math.log(2.0)


def dot(a: list[Array | None], b: list[Array | None]) -> Array | None:
    """Sum of products, where None is zero."""
    terms = [x * y for x, y in zip(a, b, strict=True) if x is not None and y is not None]
    return sum(terms[1:], terms[0]) if terms else None


def cross(a: list[Array], b: list[Array]) -> list[Array]:
    """Cross product of two vectors."""
    return [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]


def product(A: Matrix, B: Matrix) -> Matrix:
    """Product of A (2, 3) and B (3, 3)."""
    return [dot(A[3 * k : 3 * k + 3], B[n::3]) for k in range(2) for n in range(3)]


def plus(a: Array | None, b: Array | None) -> Array | None:
    """Sum, where None is zero."""
    if a is None or b is None:
        return a if b is None else b
    return a + b


@dataclass(frozen=True)
class Factor:
    """Eq. 6: the factor L of an inverse covariance, with its adjoint and tangent."""

    C: list[Array]  # c_xx, c_xy, c_yy
    det: Array  # of C
    p: Array
    q: Array
    r: Array

    @staticmethod
    def of(C: list[Array], det: Array) -> Factor:
        half = 0.5 / LN2
        p = dr.sqrt(half * C[2] / det)
        return Factor(C, det, p, -p * C[1] / C[2], dr.sqrt(half / C[2]))

    def adjoint(self, mxx: Array, mxy: Array, myy: Array) -> list[Array]:
        """dL/dC = 2 (ln 2)^2 L^T m2 L, its three entries."""
        p, q, r = self.p, self.q, self.r
        k2 = 2 * LN2 * LN2
        N = [mxx * p, mxx * q + mxy * r, mxy * p, mxy * q + myy * r]  # m2 L
        return [k2 * p * N[0], k2 * p * N[1], k2 * (q * N[1] + r * N[3])]

    def tangent(self, dxy: Array, dyy: Array, rdet: Array) -> tuple[Array, Array, Array]:
        """Tangents of p, q, r; ``rdet`` is the relative tangent of the determinant."""
        ryy = dyy / self.C[2]
        dp = 0.5 * self.p * (ryy - rdet)
        dq = 0.5 * self.q * (-ryy - rdet) - self.p * dxy / self.C[2]
        return dp, dq, -0.5 * self.r * ryy


def product_adjoint(gB: list[Array], J: Matrix, R: list[Array]) -> tuple[list[Array], list[Array]]:
    """From dL/dB, B = J R, to dL/dJ and dL/dR."""
    gJ = [dot(gB[3 * k : 3 * k + 3], R[3 * j : 3 * j + 3]) for k in range(2) for j in range(3)]
    gR = [dot([J[j], J[3 + j]], [gB[n], gB[3 + n]]) for j in range(3) for n in range(3)]
    return gJ, gR


def rotation_entries(q: list[Array]) -> list[Array]:
    """Rotation matrix of a unit quaternion wxyz, row by row."""
    w, i, j, k = q
    M = [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)]
    M += [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)]
    M += [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)]
    return M


@dataclass(frozen=True)
class Rotation:
    """Rotation matrix of a quaternion of any length; the zero quaternion gives the identity."""

    q: list[Array]  # wxyz, unit
    rq: Array  # 1/|quaternion|
    M: list[Array]  # 3 x 3, row by row

    @staticmethod
    def of(quat: list[Array]) -> Rotation:
        squared = quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3]
        rq = dr.select(squared > 0, 1 / dr.sqrt(squared), 0)
        q = [v * rq for v in quat]
        return Rotation(q, rq, rotation_entries(q))

    def adjoint(self, gM: list[Array]) -> list[Array]:
        """From dL/dM to dL/dquaternion: the matrix, then the normalisation."""
        w, i, j, k = self.q
        a, b, c = gM[7] - gM[5], gM[2] - gM[6], gM[3] - gM[1]  # the antisymmetric part
        d, h, l = gM[7] + gM[5], gM[2] + gM[6], gM[3] + gM[1]  # the symmetric part
        gq = [
            2 * (i * a + j * b + k * c),
            2 * (w * a + j * l + k * h - 2 * i * (gM[4] + gM[8])),
            2 * (w * b + i * l + k * d - 2 * j * (gM[0] + gM[8])),
            2 * (w * c + i * h + j * d - 2 * k * (gM[0] + gM[4])),
        ]
        radial = w * gq[0] + i * gq[1] + j * gq[2] + k * gq[3]
        return [self.rq * (gq[n] - self.q[n] * radial) for n in range(4)]

    def tangent(self, dquat: list[Array]) -> list[Array]:
        """From the quaternion's tangent to the matrix's."""
        w, i, j, k = self.q
        radial = w * dquat[0] + i * dquat[1] + j * dquat[2] + k * dquat[3]
        dw, di, dj, dk = (self.rq * (dquat[n] - self.q[n] * radial) for n in range(4))
        ij, ik, jk = di * j + i * dj, di * k + i * dk, dj * k + j * dk
        wi, wj, wk = dw * i + w * di, dw * j + w * dj, dw * k + w * dk
        ii, jj, kk = 2 * i * di, 2 * j * dj, 2 * k * dk
        dM = [-2 * (jj + kk), 2 * (ij - wk), 2 * (ik + wj)]
        dM += [2 * (ij + wk), -2 * (ii + kk), 2 * (jk - wi)]
        return dM + [2 * (ik - wj), 2 * (jk + wi), -2 * (ii + jj)]


@dataclass(frozen=True)
class EllipseGradient:
    """Gradients by the inputs of an ellipse."""

    J: Matrix
    R: list[Array]
    geometry: Geometry
    o: Array


@dataclass(frozen=True)
class Ellipse:
    """Eq. 4-7 of one Gaussian, with the intermediate values for its adjoint and tangent."""

    J: Matrix
    R: list[Array]
    s: list[Array]
    o: Array
    blur: Array  # px^2
    rotation: Rotation
    B: list[Array]  # 2 x 3
    BM: list[Array]  # 2 x 3
    V: list[Array]  # 2 x 3
    C: list[Array]  # c_xx, c_xy, c_yy
    n: list[Array]  # V_0 x V_1
    sharp: Array  # det(V V^T)
    det: Array  # of C
    L: Factor
    lo: Array
    options: SplatOptions

    @staticmethod
    def of(
        J: Matrix,
        R: list[Array],
        geometry: QuatScale,
        o: Array,
        blur: Array,
        options: SplatOptions,
    ) -> Ellipse:
        rotation, s = Rotation.of(geometry.quats), geometry.scales
        B = product(J, R)
        BM = product(B, rotation.M)
        V = [BM[k] * s[k % 3] for k in range(6)]
        V0, V1 = V[:3], V[3:]
        xx, xy, yy = dot(V0, V0), dot(V0, V1), dot(V1, V1)
        C = [xx + blur, xy, yy + blur]
        n = cross(V0, V1)
        sharp = dot(n, n)
        det = sharp + blur * (xx + yy + blur)
        L = Factor.of(C, det)
        lo = dr.log2(o)
        if options.antialiased:
            lo += 0.5 * dr.log2(sharp / det)
        return Ellipse(J, R, s, o, blur, rotation, B, BM, V, C, n, sharp, det, L, lo, options)

    def adjoint(self, m0: Array, mxx: Array, mxy: Array, myy: Array) -> EllipseGradient:
        """From the moments m0 = dL/dln o and m2 of eq. 16 (pixel.py).

        dL/dV = 2 dL/dC V. Antialiasing adds (ln det(V V^T) - ln det C) / 2 to ln o, where
        d det(V V^T)/dV_0 = 2 V_1 x n.
        """
        V, M = self.V, self.rotation.M
        gC = self.L.adjoint(mxx, mxy, myy)
        if self.options.antialiased:
            half, (xx, xy, yy) = -0.5 * m0 / self.det, self.C
            gC = [gC[0] + half * yy, gC[1] - half * xy, gC[2] + half * xx]
        gV = [2 * (gC[0] * V[n] + gC[1] * V[3 + n]) for n in range(3)]
        gV += [2 * (gC[1] * V[n] + gC[2] * V[3 + n]) for n in range(3)]
        if self.options.antialiased:
            by_sharp = [*cross(V[3:], self.n), *cross(self.n, V[:3])]
            scale = m0 / self.sharp
            gV = [a + scale * b for a, b in zip(gV, by_sharp, strict=True)]
        grad_s = [gV[n] * self.BM[n] + gV[3 + n] * self.BM[3 + n] for n in range(3)]
        gBM = [gV[n] * self.s[n % 3] for n in range(6)]
        B = self.B
        gM = [B[j] * gBM[n] + B[3 + j] * gBM[3 + n] for j in range(3) for n in range(3)]
        rows = [gBM[:3], gBM[3:]]
        gB = [dot(rows[k], M[3 * j : 3 * j + 3]) for k in range(2) for j in range(3)]
        gJ, gR = product_adjoint(gB, self.J, self.R)
        geometry = QuatScale(self.rotation.adjoint(gM), grad_s)
        return EllipseGradient(gJ, gR, geometry, m0 / self.o)

    def tangent(
        self, dJ: Matrix, dR: list[Array], dgeometry: QuatScale, do: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Tangents of p, q, r, lo."""
        dM, ds = self.rotation.tangent(dgeometry.quats), dgeometry.scales
        dB = [plus(a, b) for a, b in zip(product(dJ, self.R), product(self.J, dR), strict=True)]
        dBM = [
            a + b for a, b in zip(product(dB, self.rotation.M), product(self.B, dM), strict=True)
        ]
        dV = [dBM[k] * self.s[k % 3] + self.BM[k] * ds[k % 3] for k in range(6)]
        V0, V1, dV0, dV1 = self.V[:3], self.V[3:], dV[:3], dV[3:]
        dxx, dyy = 2 * dot(V0, dV0), 2 * dot(V1, dV1)
        dxy = dot(V0, dV1) + dot(V1, dV0)
        dn = [a + b for a, b in zip(cross(dV0, V1), cross(V0, dV1), strict=True)]
        dsharp = 2 * dot(self.n, dn)
        rdet = (dsharp + self.blur * (dxx + dyy)) / self.det  # relative
        dlo = do / self.o
        if self.options.antialiased:
            dlo += 0.5 * (dsharp / self.sharp - rdet)
        return *self.L.tangent(dxy, dyy, rdet), dlo / LN2


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
