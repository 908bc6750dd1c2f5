"""A 3D Gaussian's ellipse in the picture: EWA projection, forward and adjoint (paper, Eq. 1-2).

(1)  x   = R m + t                                   mean in camera space, depth z = x_2
(2)  u   = (fx x_0/z + cx, fy x_1/z + cy)            mean in the picture
(3)  J   = [[fx/z, 0, -fx a/z], [0, fy/z, -fy b/z]]  derivative of eq. 2 by x
(4)  V   = B M S,  B = J R                           M the quaternion's rotation, S = diag(scales)
(5)  C   = V V^T + blur I                            covariance in the picture
(6)  L   = [[p, q], [0, r]],  L^T L = C^-1 / (2 ln 2)
(7)  alpha(d) = o exp(-d^T C^-1 d / 2) = 2^(lo - |L d|^2),  lo = log2(o),  d = pixel centre - u

The factor of eq. 6 is what the compositing evaluates: it has one square less to cancel than the
polynomial in d, so that a needle of 100 pixels keeps its float32 digits. Base 2 saves a product.

``a`` and ``b`` are x_0/z and x_1/z, clamped to the picture and 15 % of its size on each side, as in
gsplat: the linearisation of a Gaussian far outside the picture is unbounded, and of no use.

| paper | code | shape | unit |
|---|---|---|---|
| mu | ``means`` m | (N, 3) | m, world |
| q, s | ``quats``, ``scales`` | (N, 4), (N, 3) | wxyz; m |
| alpha_i | ``opacities`` o | (N,) | |
| W | ``T_camera_world`` = [R, t] | (4, 4) | |
| mu' | ``u`` | (N, 2) | px |
| Sigma' | ``C`` = [[c_xx, c_xy], [c_xy, c_yy]] | (N, 2, 2) | px^2 |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat import packets, sh
from gva_mi.splat.camera import Camera
from gva_mi.splat.options import SplatOptions

LN2 = math.log(2.0)
MARGIN = 0.15  # of the picture's size, on each side, where eq. 3 still follows the mean

GEOMETRY = 6  # columns of a projected Gaussian before its features: u_0, u_1, p, q, r, lo
MOMENTS = 6  # columns of an adjoint slot before the features: see blend.py, eq. 6


@dataclass(frozen=True)
class View:
    """A camera as the kernels see it: arrays, so that a pose is not a constant."""

    R: list[Array]  # 9, row by row
    t: list[Array]  # 3
    f: list[Array]  # focal lengths, px
    c: list[Array]  # principal point, px
    o: list[Array]  # position in the world
    low: list[Array]  # least x_0/z, x_1/z of eq. 3
    high: list[Array]  # greatest


@dataclass(frozen=True)
class Inputs:
    """What is differentiated, as flat Dr.Jit arrays of one precision."""

    means: Array  # 3 N
    quats: Array  # 4 N
    scales: Array  # 3 N
    opacities: Array  # N
    colors: Array  # D N features, or 3 K N coefficients


def view_of(camera: Camera, F: type) -> View:
    """The camera in precision ``F``, evaluated."""
    f = np.array([camera.fx, camera.fy])
    c = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    T = camera.T_camera_world
    low, high = -(c + MARGIN * size) / f, (size - c + MARGIN * size) / f
    numbers = np.concatenate([T[:3, :3].ravel(), T[:3, 3], f, c, camera.position, low, high])
    array = F(numbers.astype(np.float64 if packets.is_double(F) else np.float32))
    x = [dr.gather(F, array, k) for k in range(numbers.size)]
    dr.eval(x)
    return View(x[:9], x[9:12], x[12:14], x[14:16], x[16:19], x[19:21], x[21:23])


@dataclass(frozen=True)
class _Ellipse:
    """The intermediate values of eq. 1-5, shared by forward and adjoint."""

    x: list[Array]
    rz: Array  # 1/z
    a: list[Array]  # x_0/z and x_1/z, clamped
    free: list[Array]  # where they are not
    q: list[Array]  # unit quaternion
    rq: Array  # 1/|quaternion|
    M: list[Array]  # 3 x 3, row by row
    J: list[Array]  # the four entries that are not zero: J_00, J_02, J_11, J_12
    B: list[Array]  # 2 x 3
    BM: list[Array]  # 2 x 3
    V: list[Array]  # 2 x 3
    C: list[Array]  # c_xx, c_xy, c_yy
    det: Array  # of C


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _ellipse(
    m: list[Array], quat: list[Array], s: list[Array], view: View, options: SplatOptions
) -> _Ellipse:
    """Eq. 1-5. A Gaussian before the near plane is not drawn; z = 1 keeps it finite."""
    R, f = view.R, view.f
    x = [_dot(R[3 * i : 3 * i + 3], m) + view.t[i] for i in range(3)]
    rz = 1 / dr.select(x[2] > options.near, x[2], 1)
    a = [dr.select(x[i] * rz < view.low[i], view.low[i], x[i] * rz) for i in range(2)]
    a = [dr.select(a[i] > view.high[i], view.high[i], a[i]) for i in range(2)]
    free = [a[i] == x[i] * rz for i in range(2)]
    J = [f[0] * rz, -f[0] * a[0] * rz, f[1] * rz, -f[1] * a[1] * rz]

    squared = quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3]
    rq = dr.select(squared > 0, 1 / dr.sqrt(squared), 0)  # a zero quaternion is no rotation
    w, i, j, k = q = [v * rq for v in quat]
    M = [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)]
    M += [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)]
    M += [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)]

    B = [J[0] * R[n] + J[1] * R[6 + n] for n in range(3)]
    B += [J[2] * R[3 + n] + J[3] * R[6 + n] for n in range(3)]
    BM = [_dot(B[3 * row : 3 * row + 3], M[n::3]) for row in range(2) for n in range(3)]
    V = [BM[n] * s[n % 3] for n in range(6)]
    V0, V1 = V[:3], V[3:]
    trace = _dot(V0, V0) + _dot(V1, V1)
    C = [_dot(V0, V0) + options.blur, _dot(V0, V1), _dot(V1, V1) + options.blur]
    # det C by the cross product of V's rows: c_xx c_yy - c_xy^2 cancels for needles
    cross = [
        V0[1] * V1[2] - V0[2] * V1[1],
        V0[2] * V1[0] - V0[0] * V1[2],
        V0[0] * V1[1] - V0[1] * V1[0],
    ]
    det = _dot(cross, cross) + options.blur * (trace + options.blur)
    return _Ellipse(x, rz, a, free, q, rq, M, J, B, BM, V, C, det)


def _factor(e: _Ellipse) -> tuple[Array, Array, Array]:
    """Eq. 6: p, q, r."""
    half = 0.5 / LN2
    p = dr.sqrt(half * e.C[2] / e.det)
    return p, -p * e.C[1] / e.C[2], dr.sqrt(half / e.C[2])


@dataclass(frozen=True)
class Ellipses:
    """Where alpha >= alpha_min in the picture: what tiles.py reads. (N,) each."""

    u: Array  # mean, px
    v: Array
    rx: Array  # half extents, px; ry < 0 where nothing is to be drawn
    ry: Array
    shear: Array  # at height d_y the columns are shear d_y -+ half sqrt(1 - (d_y / ry)^2)
    half: Array  # px
    turn: Array  # d_y of the rightmost point, px; the leftmost lies at -turn


@dataclass(frozen=True)
class _Columns:
    m: list[Array]
    quat: list[Array]
    s: list[Array]
    o: Array
    h: list[Array]


def _columns(inputs: Inputs, width: int, i: Array) -> _Columns:
    F = type(inputs.means)
    m = [dr.gather(F, inputs.means, 3 * i + k) for k in range(3)]
    s = [dr.gather(F, inputs.scales, 3 * i + k) for k in range(3)]
    quat = packets.load_rows(inputs.quats, 4, i)
    o = dr.gather(F, inputs.opacities, i)
    return _Columns(m, quat, s, o, packets.load_rows(inputs.colors, width, i))


def project(
    inputs: Inputs, width: int, harmonics: bool, view: View, options: SplatOptions
) -> tuple[list[Array], Ellipses, Array, Array]:
    """Eq. 1-7 for every Gaussian.

    Args:
        inputs: the Gaussians.
        width: columns of ``inputs.colors``: D, or 3 K where ``harmonics``.
        harmonics: whether the colours are coefficients.
        view: the camera.
        options: cut-offs.

    Returns:
        The GEOMETRY columns and behind them the features, colour then depth; the ellipses; three
        standard deviations along the longer axis, px; whether all inputs are finite.
    """
    F = type(inputs.means)
    g = _columns(inputs, width, dr.arange(dr.uint32_array_t(F), dr.width(inputs.opacities)))
    e = _ellipse(g.m, g.quat, g.s, view, options)
    p, q, r = _factor(e)
    u = [view.f[k] * e.x[k] * e.rz + view.c[k] for k in range(2)]
    lo = dr.log2(g.o)
    features = sh.color(g.h, g.m, view.o) if harmonics else g.h

    # alpha >= alpha_min inside d^T C^-1 d <= tau: an ellipse with half extents sqrt(tau C_ii)
    tau = 2 * LN2 * (lo - math.log2(options.alpha_min))
    visible = (e.x[2] > options.near) & (e.x[2] < options.far) & (tau > 0)
    visible &= dr.isfinite(e.det) & dr.isfinite(u[0]) & dr.isfinite(u[1])
    xx, xy, yy = e.C
    tau = dr.select(visible, tau, 0)
    rx, ry = dr.sqrt(tau * xx), dr.select(visible, dr.sqrt(tau * yy), -1)
    ellipses = Ellipses(*u, rx, ry, xy / yy, dr.sqrt(tau * e.det / yy), xy / xx * rx)

    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    radii = 3 * dr.sqrt(middle + dr.sqrt(half * half + xy * xy))
    finite = dr.isfinite(sum((dr.abs(v) for v in [*g.m, *g.quat, *g.s, *g.h]), dr.abs(g.o)))
    return [*u, p, q, r, lo, *features, e.x[2]], ellipses, radii, finite


def project_adjoint(
    inputs: Inputs,
    width: int,
    harmonics: bool,
    view: View,
    options: SplatOptions,
    moments: list[Array],
    drawn: Array,
    target: Inputs,
    grad_u: Array,
) -> None:
    """Eq. 1-7 reversed, for every Gaussian.

    With the moments m0, m1, m2 of blend.py, eq. 6:

        dL/do = m0 / o,   dL/du = 2 ln2 L^T m1,   dL/dC = 2 (ln 2)^2 L^T m2 L,   dL/dV = 2 dL/dC V

    Args:
        inputs, width, harmonics, view, options: as :func:`project` took them.
        moments: blend.py, eq. 6: MOMENTS columns, the gradients of the colour's channels and, if
            the loss looks at it, that of the depth.
        drawn: False where a Gaussian has no pairs, and so no gradient.
        target: memory for the gradients.
        grad_u: memory for the gradient of the means in the picture, 2 N.
    """
    F = type(inputs.means)
    U = dr.uint32_array_t(F)
    i = dr.arange(U, dr.width(inputs.opacities))
    depth = len(moments) > MOMENTS + (3 if harmonics else width)
    m0, mx, my, mxx, mxy, myy, *grad_f = moments

    g = _columns(inputs, width, i)
    m, s, R, f = g.m, g.s, view.R, view.f
    e = _ellipse(m, g.quat, s, view, options)
    p, q, r = _factor(e)
    V, x, rz = e.V, e.x, e.rz

    # eq. 7, 6
    grad_o = dr.select(drawn, m0 / g.o, 0)
    k1, k2 = 2 * LN2, 2 * LN2 * LN2
    gu = [k1 * p * mx, k1 * (q * mx + r * my)]
    N = [mxx * p, mxx * q + mxy * r, mxy * p, mxy * q + myy * r]  # m2 L
    gC = [k2 * p * N[0], k2 * p * N[1], k2 * (q * N[1] + r * N[3])]

    # eq. 5, 4
    gV = [2 * (gC[0] * V[n] + gC[1] * V[3 + n]) for n in range(3)]
    gV += [2 * (gC[1] * V[n] + gC[2] * V[3 + n]) for n in range(3)]
    grad_s = [gV[n] * e.BM[n] + gV[3 + n] * e.BM[3 + n] for n in range(3)]
    gBM = [gV[n] * s[n % 3] for n in range(6)]
    B, M = e.B, e.M
    gM = [B[j] * gBM[n] + B[3 + j] * gBM[3 + n] for j in range(3) for n in range(3)]
    gB = [
        _dot(gBM[3 * row : 3 * row + 3], M[3 * j : 3 * j + 3]) for row in range(2) for j in range(3)
    ]
    grad_q = _rotation_adjoint(e, gM)

    # eq. 3, 2
    J = e.J
    gJ = [_dot(gB[:3], R[:3]), _dot(gB[:3], R[6:]), _dot(gB[3:], R[3:6]), _dot(gB[3:], R[6:])]
    ga = [-f[k] * rz * gJ[2 * k + 1] for k in range(2)]
    # u = f x/z + c, and a = x/z where it is not clamped
    gt = [f[k] * gu[k] + dr.select(e.free[k], ga[k], 0) for k in range(2)]
    gx = [gt[0] * rz, gt[1] * rz]
    gz = -rz * (gx[0] * x[0] + gx[1] * x[1] + sum(a * b for a, b in zip(J, gJ, strict=True)))
    gx.append(gz + grad_f.pop() if depth else gz)

    # eq. 1
    grad_m = [R[n] * gx[0] + R[3 + n] * gx[1] + R[6 + n] * gx[2] for n in range(3)]
    grad_h = grad_f
    if harmonics:
        grad_h, toward = sh.color_adjoint(g.h, m, view.o, grad_f)
        grad_m = [a + b for a, b in zip(grad_m, toward, strict=True)]

    keep = lambda columns: [dr.select(drawn, c, 0) for c in columns]
    for k in range(3):
        dr.scatter(target.means, keep(grad_m)[k], 3 * i + k, mode=dr.ReduceMode.NoConflicts)
        dr.scatter(target.scales, keep(grad_s)[k], 3 * i + k, mode=dr.ReduceMode.NoConflicts)
    packets.store_rows(target.quats, keep(grad_q), i)
    packets.store_rows(target.colors, keep(grad_h), i)
    packets.store_rows(grad_u, keep(gu), i)
    dr.scatter(target.opacities, grad_o, i, mode=dr.ReduceMode.NoConflicts)


def _rotation_adjoint(e: _Ellipse, gM: list[Array]) -> list[Array]:
    """From dL/dM to dL/dquaternion: the matrix of the unit quaternion, then the normalisation."""
    w, i, j, k = e.q
    a, b, c = gM[7] - gM[5], gM[2] - gM[6], gM[3] - gM[1]  # the antisymmetric part
    d, h, l = gM[7] + gM[5], gM[2] + gM[6], gM[3] + gM[1]  # the symmetric part
    gq = [
        2 * (i * a + j * b + k * c),
        2 * (w * a + j * l + k * h - 2 * i * (gM[4] + gM[8])),
        2 * (w * b + i * l + k * d - 2 * j * (gM[0] + gM[8])),
        2 * (w * c + i * h + j * d - 2 * k * (gM[0] + gM[4])),
    ]
    radial = w * gq[0] + i * gq[1] + j * gq[2] + k * gq[3]
    return [e.rq * (gq[n] - e.q[n] * radial) for n in range(4)]
