"""Projection of a point into the picture, and its derivative: three camera models (paper, Eq. 2).

From a point x in camera space, with focal lengths f and principal point c, both px, and k = 0, 1:

(2)  u_k = w_k + c_k               mean in the picture
(3)  J   = du/dx, (2, 3)           a pinhole's w is held within the picture and its margin

| model | w_k | J |
|---|---|---|
| pinhole | f_k x_k / z | J_kk = f_k / z,  J_k2 = -held(w_k) / z |
| ortho | f_k x_k | J_kk = f_k |
| fisheye | f_k x_k s,  s = atan2(r, z) / r | J_kl = f_k (s d_kl + e x_k x_l),  J_k2 = f_k x_k h |

Fisheye is the equidistant lens: pixels from the centre grow with the angle from the axis. s, e, h
are functions of t = r^2 = x_0^2 + x_1^2 and z. With rho^2 = t + z^2, and subscripts for partials:

    s_t = e / 2    s_z = h = -1 / rho^2    e_t = k    e_z = 2 h_t = 2 / rho^4    h_z = 2 z / rho^4

``held`` clamps to the picture and 15 % of its size on each side, as in gsplat: the linearisation of
a Gaussian far outside a pinhole's picture is unbounded and useless.

Each model is one class: ``at`` is its forward, and it keeps what ``adjoint`` and ``tangent`` need.
Entries of J that are zero for every x are None.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.inputs import CameraArrays

Matrix = list[Array | None]  # row by row; None is a zero


@dataclass(frozen=True)
class LensGradient:
    """Gradients by the point in camera space, the focal lengths and the principal point."""

    x: list[Array]
    f: list[Array]
    c: list[Array]


@dataclass(frozen=True)
class Pinhole:
    """Rays through one point."""

    x: list[Array]
    f: list[Array]
    rz: Array  # 1/z
    held: list[Array]  # w, clamped
    free: list[Array]  # where it is not
    u: list[Array]
    J: Matrix

    @staticmethod
    def at(x: list[Array], z: Array, view: CameraArrays) -> Pinhole:
        f, rz = view.f, 1 / z
        w = [f[k] * (x[k] * rz) for k in range(2)]
        held = [dr.select(w[k] < view.low[k], view.low[k], w[k]) for k in range(2)]
        held = [dr.select(held[k] > view.high[k], view.high[k], held[k]) for k in range(2)]
        free = [held[k] == w[k] for k in range(2)]
        u = [w[k] + view.c[k] for k in range(2)]
        J = [f[0] * rz, None, -held[0] * rz, None, f[1] * rz, -held[1] * rz]
        return Pinhole(x, f, rz, held, free, u, J)

    def adjoint(self, gu: list[Array], gJ: Matrix) -> LensGradient:
        x, f, rz = self.x, self.f, self.rz
        by_axis, by_depth = [gJ[0], gJ[4]], [gJ[2], gJ[5]]
        gheld = [-rz * by_depth[k] for k in range(2)]
        gw = [gu[k] + dr.select(self.free[k], gheld[k], 0) for k in range(2)]
        gc = [gu[k] - dr.select(self.free[k], 0, gheld[k]) for k in range(2)]  # bounds hold -c
        gf = [rz * (x[k] * gw[k] + by_axis[k]) for k in range(2)]
        gx = [f[k] * rz * gw[k] for k in range(2)]
        grz = [f[k] * (x[k] * gw[k] + by_axis[k]) - self.held[k] * by_depth[k] for k in range(2)]
        return LensGradient([*gx, -rz * rz * (grz[0] + grz[1])], gf, gc)

    def tangent(self, dx: list[Array], view: CameraArrays) -> tuple[list[Array], Matrix]:
        x, f, rz = self.x, self.f, self.rz
        drz = -rz * rz * dx[2]
        dw = [view.f[k] * x[k] * rz + f[k] * (dx[k] * rz + x[k] * drz) for k in range(2)]
        dheld = [dr.select(self.free[k], dw[k], -view.c[k]) for k in range(2)]
        dJ: Matrix = [None] * 6
        for k in range(2):
            dJ[4 * k] = view.f[k] * rz + f[k] * drz
            dJ[3 * k + 2] = -(dheld[k] * rz + self.held[k] * drz)
        return [dw[k] + view.c[k] for k in range(2)], dJ


@dataclass(frozen=True)
class Ortho:
    """Parallel rays: focal lengths are pixels per metre."""

    x: list[Array]
    f: list[Array]
    u: list[Array]
    J: Matrix

    @staticmethod
    def at(x: list[Array], z: Array, view: CameraArrays) -> Ortho:
        f = view.f
        u = [f[k] * x[k] + view.c[k] for k in range(2)]
        return Ortho(x, f, u, [f[0] + 0 * z, None, None, None, f[1] + 0 * z, None])

    def adjoint(self, gu: list[Array], gJ: Matrix) -> LensGradient:
        x, f = self.x, self.f
        gf = [x[k] * gu[k] + gJ[4 * k] for k in range(2)]
        return LensGradient([f[0] * gu[0], f[1] * gu[1], gu[0] * 0], gf, gu)

    def tangent(self, dx: list[Array], view: CameraArrays) -> tuple[list[Array], Matrix]:
        x, f = self.x, self.f
        du = [view.f[k] * x[k] + f[k] * dx[k] + view.c[k] for k in range(2)]
        return du, [view.f[0] + 0 * dx[2], None, None, None, view.f[1] + 0 * dx[2], None]


@dataclass(frozen=True)
class Fisheye:
    """Equidistant rays: pixels from the centre grow with the angle from the axis."""

    x: list[Array]
    f: list[Array]
    s: Array
    e: Array
    h: Array
    k: Array
    u: list[Array]
    J: Matrix

    @staticmethod
    def at(x: list[Array], z: Array, view: CameraArrays) -> Fisheye:
        f = view.f
        t = x[0] * x[0] + x[1] * x[1]
        h = -1 / (t + z * z)
        s, e, k = _equidistant(t, z, h)
        u = [f[i] * x[i] * s + view.c[i] for i in range(2)]
        cross = e * x[0] * x[1]
        J = [f[0] * (s + e * x[0] * x[0]), f[0] * cross, f[0] * x[0] * h]
        J += [f[1] * cross, f[1] * (s + e * x[1] * x[1]), f[1] * x[1] * h]
        return Fisheye([*x[:2], z], f, s, e, h, k, u, J)

    def adjoint(self, gu: list[Array], gJ: Matrix) -> LensGradient:
        (x, y, z), (fx, fy), e, h = self.x, self.f, self.e, self.h
        a, b = [fx * g for g in gJ[:3]], [fy * g for g in gJ[3:]]  # by J / f
        v = [fx * gu[0], fy * gu[1]]
        cross = a[1] + b[0]
        gs = x * v[0] + y * v[1] + a[0] + b[1]
        ge = x * x * a[0] + x * y * cross + y * y * b[1]
        gh = x * a[2] + y * b[2]
        gt = gs * e / 2 + ge * self.k + gh * h * h
        gx = [
            self.s * v[0] + e * (2 * x * a[0] + y * cross) + h * a[2] + 2 * x * gt,
            self.s * v[1] + e * (2 * y * b[1] + x * cross) + h * b[2] + 2 * y * gt,
            gs * h + 2 * h * h * (ge + z * gh),
        ]
        gf = [self.s * (x, y)[k] * gu[k] for k in range(2)]
        gf = [
            gf[k] + sum(self.J[3 * k + j] * gJ[3 * k + j] for j in range(3)) / self.f[k]
            for k in range(2)
        ]
        return LensGradient(gx, gf, gu)

    def tangent(self, dx: list[Array], view: CameraArrays) -> tuple[list[Array], Matrix]:
        x, f, s, e, h = self.x, self.f, self.s, self.e, self.h
        dt = 2 * (x[0] * dx[0] + x[1] * dx[1])
        ds, de = e / 2 * dt + h * dx[2], self.k * dt + 2 * h * h * dx[2]
        dh = h * h * (dt + 2 * x[2] * dx[2])
        du, dJ = [], []
        for k in range(2):
            du.append(view.f[k] * x[k] * s + f[k] * (dx[k] * s + x[k] * ds) + view.c[k])
            for l in range(2):
                d = e * (dx[k] * x[l] + x[k] * dx[l]) + de * x[k] * x[l]
                dJ.append(f[k] * (d + ds if k == l else d))
            dJ.append(f[k] * (dx[k] * h + x[k] * dh))
            for j in range(3 * k, 3 * k + 3):
                dJ[j] = dJ[j] + view.f[k] / f[k] * self.J[j]
        return du, dJ


TERMS = 12  # of the series of s, e and k in q = t / z^2


def _equidistant(t: Array, z: Array, h: Array) -> tuple[Array, Array, Array]:
    """Compute the fisheye's s, e and k; by series near the axis, where the formulas cancel."""
    rz = 1 / z
    q = t * rz * rz
    near = q < (0.04 if packets.is_double(type(t)) else 0.25)
    far = dr.select(near, 1, t)
    r = dr.sqrt(far)
    s = dr.atan2(r, z) / r
    e = (-z * h - s) / far
    k = -(z * h * h + 1.5 * e) / far
    # s z = sum (-q)^n / (2n + 1);  e = 2 s_t,  k = e_t  term by term
    odd = [(-1) ** n / (2 * n + 1) for n in range(TERMS + 2)]
    series = [
        _polynomial(q, odd[:TERMS]),
        _polynomial(q, [2 * n * odd[n] for n in range(1, TERMS + 1)]),
        _polynomial(q, [2 * n * (n - 1) * odd[n] for n in range(2, TERMS + 2)]),
    ]
    powers = [rz, rz * rz * rz, rz * rz * rz * rz * rz]
    found = zip((s, e, k), series, powers, strict=True)
    return tuple(dr.select(near, near_axis * power, x) for x, near_axis, power in found)


def _polynomial(q: Array, coefficients: list[float]) -> Array:
    value = q * 0 + coefficients[-1]
    for c in coefficients[-2::-1]:
        value = dr.fma(value, q, c)
    return value


Lens = Pinhole | Ortho | Fisheye
LENSES: dict[str, type[Lens]] = {"pinhole": Pinhole, "ortho": Ortho, "fisheye": Fisheye}
