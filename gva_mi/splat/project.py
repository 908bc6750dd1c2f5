"""From a 3D Gaussian to its ellipse in the picture: EWA projection, forward and adjoint (paper, Eq. 1-2).

(1)  x   = R m + t                                   mean in camera space, z = x_2 its depth
(2)  u   = (fx x_0/z + cx, fy x_1/z + cy)            mean in the picture
(3)  J   = [[fx/z, 0, -fx a/z], [0, fy/z, -fy b/z]]  derivative of eq. 2 by x
(4)  V   = B M S,  B = J R                           M the rotation of the quaternion, S = diag(scales)
(5)  C   = V V^T + blur I                            covariance in the picture
(6)  L   = [[p, q], [0, r]],  L^T L = C^-1 / (2 ln 2)
(7)  alpha(d) = o exp(-d^T C^-1 d / 2) = 2^(lo - |L d|^2),  lo = log2(o),  d = pixel centre - u

The upper triangular factor of eq. 6 is what the compositing kernel evaluates: one square less to cancel than the
polynomial in d, so that a needle of 100 pixels keeps its float32 digits, and the base-2 exponent saves a product.
``a`` and ``b`` are x_0/z and x_1/z clamped to the picture plus 15 % of its size on each side, as gsplat does it: the
linearisation of a Gaussian far outside the picture is of no use and unbounded.

| paper | code | shape | unit |
|---|---|---|---|
| mu | ``means`` m | (N, 3) | m, world |
| q, s | ``quats``, ``scales`` | (N, 4), (N, 3) | wxyz; m |
| alpha_i | ``opacities`` o | (N,) | |
| W = [R, t] | ``T_camera_world`` | (4, 4) | |
| mu' | ``u`` | (N, 2) | px |
| Sigma' | ``C`` = [[c_xx, c_xy], [c_xy, c_yy]] | (N, 2, 2) | px^2 |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from gva_mi.splat import packets, sh
from gva_mi.splat.camera import Camera
from gva_mi.splat.options import SplatOptions

LN2 = math.log(2.0)
MARGIN = 0.15  # of the picture's size, on each side, where J still follows the mean (gsplat: 0.3 tan(fov/2))

GEOMETRY = 6  # columns of a projected Gaussian before its features: u_0, u_1, p, q, r, lo
MOMENTS = 6  # columns of an adjoint slot before the features: see blend.py, eq. 6
FOOTPRINT = 8  # columns of a footprint


@dataclass(frozen=True)
class View:
    """A camera as the kernels see it: arrays of size one, so that another pose is not another kernel."""

    R: list[Any]  # 9, row by row
    t: list[Any]  # 3
    f: list[Any]  # focal lengths, px
    c: list[Any]  # principal point, px
    o: list[Any]  # position in the world
    low: list[Any]  # least x_0/z, x_1/z of eq. 3
    high: list[Any]  # greatest


@dataclass(frozen=True)
class Inputs:
    """What is differentiated, as flat Dr.Jit arrays of one precision."""

    means: Any  # 3 N
    quats: Any  # 4 N
    scales: Any  # 3 N
    opacities: Any  # N
    colors: Any  # D N features, or 3 K N coefficients


def view_of(camera: Camera, F: type) -> View:
    """The camera in precision ``F``, evaluated."""
    f = np.array([camera.fx, camera.fy])
    c = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    T = camera.T_camera_world
    low, high = -(c + MARGIN * size) / f, (size - c + MARGIN * size) / f
    numbers = np.concatenate([T[:3, :3].ravel(), T[:3, 3], f, c, camera.position, low, high])
    array = F(numbers.astype(np.float64 if dr.is_double_v(F) else np.float32))
    x = [dr.gather(F, array, k) for k in range(numbers.size)]
    dr.eval(x)
    return View(x[:9], x[9:12], x[12:14], x[14:16], x[16:19], x[19:21], x[21:23])


@dataclass(frozen=True)
class _Ellipse:
    """The intermediate values of eq. 1-5, shared by forward and adjoint."""

    x: list[Any]
    rz: Any  # 1/z
    a: list[Any]  # x_0/z and x_1/z, clamped
    free: list[Any]  # where they are not
    q: list[Any]  # unit quaternion
    rq: Any  # 1/|quaternion|
    M: list[Any]  # 3 x 3, row by row
    J: list[Any]  # the four entries that are not zero: J_00, J_02, J_11, J_12
    B: list[Any]  # 2 x 3
    BM: list[Any]  # 2 x 3
    V: list[Any]  # 2 x 3
    C: list[Any]  # c_xx, c_xy, c_yy
    det: Any  # of C


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _ellipse(m: list[Any], quat: list[Any], s: list[Any], view: View, options: SplatOptions) -> _Ellipse:
    """Eq. 1-5. Behind the near plane z is replaced by 1: such a Gaussian is dropped, and stays finite."""
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
    cross = [V0[1] * V1[2] - V0[2] * V1[1], V0[2] * V1[0] - V0[0] * V1[2], V0[0] * V1[1] - V0[1] * V1[0]]
    det = _dot(cross, cross) + options.blur * (trace + options.blur)
    return _Ellipse(x, rz, a, free, q, rq, M, J, B, BM, V, C, det)


def _factor(e: _Ellipse) -> tuple[Any, Any, Any]:
    """Eq. 6: p, q, r."""
    half = 0.5 / LN2
    p = dr.sqrt(half * e.C[2] / e.det)
    return p, -p * e.C[1] / e.C[2], dr.sqrt(half / e.C[2])


@dataclass(frozen=True)
class Projected:
    """The Gaussians in the picture."""

    rows: packets.Packets  # GEOMETRY + features columns: what blend.py reads
    footprints: packets.Packets  # FOOTPRINT columns: what tiles.py reads
    depths: Any  # (N,) z
    radii: Any  # (N,) px, 3 standard deviations along the longer axis; 0 where not drawn
    finite: Any  # (N,) False where an input of this Gaussian is NaN or infinite


@dataclass(frozen=True)
class _Columns:
    m: list[Any]
    quat: list[Any]
    s: list[Any]
    o: Any
    h: list[Any]


def _columns(inputs: Inputs, width: int, i: Any) -> _Columns:
    F = type(inputs.means)
    m = [dr.gather(F, inputs.means, 3 * i + k) for k in range(3)]
    s = [dr.gather(F, inputs.scales, 3 * i + k) for k in range(3)]
    quat = packets.load_rows(inputs.quats, 4, i)
    o = dr.gather(F, inputs.opacities, i)
    return _Columns(m, quat, s, o, packets.load_rows(inputs.colors, width, i))


@dr.freeze(limit=64, warn_after=1000)
def project(
    inputs: Inputs, width: int, harmonics: bool, view: View, options: SplatOptions, target: Any
) -> Projected:
    """Eq. 1-7 for every Gaussian.

    Args:
        inputs: the Gaussians.
        width: columns of ``inputs.colors``: D, or 3 K where ``harmonics``.
        harmonics: whether the colours are coefficients.
        view: the camera. options: cut-offs.
        target: memory for the rows and the footprints.
    """
    F = type(inputs.means)
    i = dr.arange(dr.uint32_array_t(F), dr.width(inputs.opacities))
    g = _columns(inputs, width, i)
    e = _ellipse(g.m, g.quat, g.s, view, options)
    p, q, r = _factor(e)
    u = [view.f[k] * e.x[k] * e.rz + view.c[k] for k in range(2)]
    lo = dr.log2(g.o)
    features = sh.color(g.h, g.m, view.o) if harmonics else g.h
    packets.store(target[0], [*u, p, q, r, lo, *features, e.x[2]], i)

    # alpha >= alpha_min inside d^T C^-1 d <= tau: an ellipse with half extents sqrt(tau C_ii)
    tau = 2 * LN2 * (lo - math.log2(options.alpha_min))
    visible = (e.x[2] > options.near) & (e.x[2] < options.far) & (tau > 0) & dr.isfinite(e.det)
    visible &= dr.isfinite(u[0]) & dr.isfinite(u[1])
    xx, xy, yy = e.C
    tau = dr.select(visible, tau, 0)
    rx, ry = dr.sqrt(tau * xx), dr.select(visible, dr.sqrt(tau * yy), -1)
    half = dr.sqrt(tau * e.det / yy)  # half width at the mean's row
    packets.store(target[1], [*u, rx, ry, xy / yy, half, xy / xx * rx, e.x[2]], i)

    middle = 0.5 * (xx + yy)
    radii = 3 * dr.sqrt(middle + dr.sqrt(dr.square(0.5 * (xx - yy)) + xy * xy))
    total = sum((dr.abs(v) for v in [*g.m, *g.quat, *g.s, *g.h]), dr.abs(g.o))
    finite = dr.isfinite(total)
    dr.eval(target, radii, finite, e.x[2])
    return Projected(target[0], target[1], e.x[2], dr.select(visible, radii, 0), finite)
