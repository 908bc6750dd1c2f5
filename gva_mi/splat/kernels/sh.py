"""Colour by spherical harmonics: a Gaussian's colour as seen from a direction.

(8)  d   = (m - o) / |m - o|                  from the camera's position o to the mean m
(9)  b_i = real spherical harmonics of d, i < K = (degree + 1)^2, in the sign and order of 3DGS
(10) c   = max(0, sum_i b_i h_i + 1/2)        per channel, h_i the coefficients

Below, ``d = (x, y, z)``. The basis functions are written as homogeneous polynomials. Any extension
off the unit sphere is right, because eq. 8 projects the radial part of the derivative away.
"""

from __future__ import annotations

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.splat.gaussians import degree_of
from gva_mi.splat.kernels.vectors import Vec3, dot, each

# Normalisations of the basis of degree 0 to 4 (C1 = sqrt(3 / 4 pi)): the magnitudes of 3DGS's
# utils/sh_utils.py, whose signs stand in the formulas of basis().
C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (
    0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154,
    1.445305721320277,
)  # fmt: skip
C4 = (
    2.5033429417967046,
    1.7701307697799304,
    0.9461746957575601,
    0.6690465435572892,
    0.10578554691520431,
    0.47308734787878004,
    0.6258357354491761,
)


def basis(degree: int, x: Array, y: Array, z: Array) -> list[Array]:
    """Eq. 9: the K values b_i."""
    b = [x * 0 + C0]
    if degree >= 1:
        b += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        b += [C2[0] * xy, -C2[0] * yz, C2[1] * (2 * zz - xx - yy), -C2[0] * xz, C2[2] * (xx - yy)]
    if degree >= 3:
        b += [
            -C3[0] * y * (3 * xx - yy),
            C3[1] * xy * z,
            -C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -C3[2] * x * (4 * zz - xx - yy),
            C3[4] * z * (xx - yy),
            -C3[0] * x * (xx - 3 * yy),
        ]
    if degree >= 4:
        s = xx + yy
        b += [
            C4[0] * xy * (xx - yy),
            -C4[1] * yz * (3 * xx - yy),
            C4[2] * xy * (6 * zz - s),
            -C4[3] * yz * (4 * zz - 3 * s),
            C4[4] * (8 * zz * zz - 24 * s * zz + 3 * s * s),
            -C4[3] * xz * (4 * zz - 3 * s),
            C4[5] * (xx - yy) * (6 * zz - s),
            -C4[1] * xz * (xx - 3 * yy),
            C4[6] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return b


def basis_adjoint(degree: int, x: Array, y: Array, z: Array, g: list[Array]) -> Vec3:
    """Eq. 9 reversed: sum_i g_i db_i/dd, from the gradients ``g`` of the K values."""
    gx, gy, gz = x * 0, x * 0, x * 0
    if degree >= 1:
        gx, gy, gz = -C1 * g[3], -C1 * g[1], C1 * g[2]
    if degree >= 2:
        a, b, c, d, e = C2[0] * g[4], -C2[0] * g[5], C2[1] * g[6], -C2[0] * g[7], C2[2] * g[8]
        gx += a * y - 2 * c * x + d * z + 2 * e * x
        gy += a * x + b * z - 2 * c * y - 2 * e * y
        gz += b * y + 4 * c * z + d * x
    if degree >= 3:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        a, b, c, d = -C3[0] * g[9], C3[1] * g[10], -C3[2] * g[11], C3[3] * g[12]
        e, f, h = -C3[2] * g[13], C3[4] * g[14], -C3[0] * g[15]
        gx += 6 * a * xy + b * yz - 2 * c * xy - 6 * d * xz
        gx += e * (4 * zz - 3 * xx - yy) + 2 * f * xz + 3 * h * (xx - yy)
        gy += 3 * a * (xx - yy) + b * xz + c * (4 * zz - xx - 3 * yy) - 6 * d * yz
        gy -= 2 * e * xy + 2 * f * yz + 6 * h * xy
        gz += b * xy + 8 * c * yz + d * (6 * zz - 3 * xx - 3 * yy) + 8 * e * xz + f * (xx - yy)
    if degree >= 4:
        s = xx + yy
        a, b, c, d, e = C4[0] * g[16], -C4[1] * g[17], C4[2] * g[18], -C4[3] * g[19], C4[4] * g[20]
        f, h, k, l = -C4[3] * g[21], C4[5] * g[22], -C4[1] * g[23], C4[6] * g[24]
        p, q = 6 * zz - s, 4 * zz - 3 * s
        gx += a * y * (3 * xx - yy) + 6 * b * xy * z + c * (y * p - 2 * xx * y) - 6 * d * xy * z
        gx += e * x * (12 * s - 48 * zz) + f * (z * q - 6 * xx * z) + 2 * h * x * (p - xx + yy)
        gx += 3 * k * z * (xx - yy) + 4 * l * x * (xx - 3 * yy)
        gy += a * x * (xx - 3 * yy) + 3 * b * z * (xx - yy) + c * (x * p - 2 * x * yy)
        gy += d * (z * q - 6 * yy * z) + e * y * (12 * s - 48 * zz) - 6 * f * xy * z
        gy -= 2 * h * y * (p + xx - yy) + 6 * k * xy * z + 4 * l * y * (3 * xx - yy)
        gz += b * y * (3 * xx - yy) + 12 * c * xy * z + d * y * (q + 8 * zz)
        gz += e * z * (32 * zz - 48 * s) + f * x * (q + 8 * zz) + 12 * h * z * (xx - yy)
        gz += k * x * (xx - 3 * yy)
    return Vec3(gx, gy, gz)


def direction(m: Vec3, o: Vec3) -> tuple[Vec3, Array]:
    """Eq. 8: the unit direction and 1/|m - o|; zero for a mean at the camera."""
    v = each(lambda m, o: m - o, m, o)
    squared = dot(v, v)
    reciprocal = dr.select(squared > 0, 1 / dr.sqrt(squared), 0)
    return v * reciprocal, reciprocal


def direction_tangent(d: Vec3, reciprocal: Array, dv: Vec3) -> Vec3:
    """Derivative of eq. 8 along ``dv``, of m - o. It is symmetric, so it is its own adjoint."""
    radial = dot(d, dv)
    return each(lambda dv, d: (dv - d * radial) * reciprocal, dv, d)


def by_coefficient(columns: list[Array]) -> list[Vec3]:
    """Group 3K columns to the K coefficients of red, green and blue."""
    return [Vec3(*columns[i : i + 3]) for i in range(0, len(columns), 3)]


def weighted_sum(b: list[Array], h: list[Vec3]) -> Vec3:
    """sum_i b_i h_i for each channel."""
    total = each(lambda h: b[0] * h, h[0])
    for b_i, h_i in zip(b[1:], h[1:], strict=True):
        total = each(lambda s, h, b=b_i: s + b * h, total, h_i)
    return total


def color(columns: list[Array], m: Vec3, o: Vec3) -> list[Array]:
    """Eq. 10: the colour of the three channels.

    Args:
        columns: 3K, coefficient by coefficient.
        m: mean, world. o: camera position, world.
    """
    h, (d, _) = by_coefficient(columns), direction(m, o)
    sums = weighted_sum(basis(degree_of(len(h)), *d), h)
    return [dr.select(s > -0.5, s + 0.5, 0) for s in sums]


def color_tangent(
    columns: list[Array], m: Vec3, o: Vec3, dcolumns: list[Array], dm: Vec3, do: Vec3
) -> list[Array]:
    """Eq. 10 along tangents of the coefficients, the mean and the camera's position."""
    h, dh, (d, reciprocal) = by_coefficient(columns), by_coefficient(dcolumns), direction(m, o)
    degree = degree_of(len(h))
    b = basis(degree, *d)
    dd = direction_tangent(d, reciprocal, each(lambda dm, do: dm - do, dm, do))
    dc = []
    sums = weighted_sum(b, h), weighted_sum(b, dh), zip(*h, strict=True)
    for s, ds, h_k in zip(*sums, strict=True):
        ds = ds + dot(basis_adjoint(degree, *d, h_k), dd)
        dc.append(dr.select(s > -0.5, ds, 0))
    return dc


def color_adjoint(
    columns: list[Array], m: Vec3, o: Vec3, grad_c: list[Array]
) -> tuple[list[Array], Vec3]:
    """Eq. 10 reversed: gradients of the 3K coefficients and of the mean."""
    h, (d, reciprocal) = by_coefficient(columns), direction(m, o)
    degree = degree_of(len(h))
    b = basis(degree, *d)
    sums = weighted_sum(b, h)
    grad_s = Vec3(*(dr.select(s > -0.5, g, 0) for s, g in zip(sums, grad_c, strict=True)))

    grad_h = [b_i * g for b_i in b for g in grad_s]
    grad_b = [dot(h_i, grad_s) for h_i in h]
    grad_d = basis_adjoint(degree, *d, grad_b)
    return grad_h, direction_tangent(d, reciprocal, grad_d)
