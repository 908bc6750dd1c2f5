"""Projection of a point into the picture, and its derivative: three camera models (paper, Eq. 2).

From a point (x, y, z) in camera space, with focal lengths f and principal point c, both px:

(2)  u = w + c               mean in the picture
(3)  J = du/d(x, y, z)       a pinhole's w is held within the picture and its margin

| model | w | J |
|---|---|---|
| pinhole | f_x x / z | f_x / z, 0, -held(w_x) / z |
| | f_y y / z | 0, f_y / z, -held(w_y) / z |
| ortho | f_x x | f_x, 0, 0 |
| | f_y y | 0, f_y, 0 |
| fisheye, s = atan2(r, z) / r | f_x x s | f_x (s + e x^2), f_x e x y, f_x x h |
| | f_y y s | f_y e x y, f_y (s + e y^2), f_y y h |

Fisheye is the equidistant lens: pixels from the centre grow with the angle from the axis. s, e, h
are functions of t = r^2 = x^2 + y^2 and z. With rho^2 = t + z^2, and subscripts for partials:

    s_t = e / 2    s_z = h = -1 / rho^2    e_t = k    e_z = 2 h_t = 2 / rho^4    h_z = 2 z / rho^4

``held`` clamps to the picture and 15 % of its size on each side, as in gsplat: the linearisation of
a Gaussian far outside a pinhole's picture is unbounded and useless.

Each model is one class: ``at`` is its forward, and it keeps what ``adjoint`` and ``tangent`` need.
Entries of J that are zero for every point are None.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.inputs import CameraArrays
from gva_mi.splat.kernels.vectors import Mat23, Vec2, Vec3, dot, each


@dataclass(frozen=True)
class LensGradient:
    """Gradients of the point in camera space, the focal lengths and the principal point."""

    point: Vec3
    f: Vec2
    c: Vec2


@dataclass(frozen=True)
class Pinhole:
    """Rays through one point."""

    point: Vec3
    f: Vec2
    rz: Array  # 1/z
    held: Vec2  # w, clamped
    free: Vec2  # where it is not
    u: Vec2
    J: Mat23

    @staticmethod
    def at(point: Vec3, view: CameraArrays) -> Pinhole:
        (x, y, z), (fx, fy) = point, view.f
        rz = 1 / z
        w = Vec2(fx * (x * rz), fy * (y * rz))
        held = each(lambda w, low: dr.select(w < low, low, w), w, view.low)
        held = each(lambda w, high: dr.select(w > high, high, w), held, view.high)
        free = each(lambda a, b: a == b, held, w)
        J = Mat23(Vec3(fx * rz, None, -held.x * rz), Vec3(None, fy * rz, -held.y * rz))
        return Pinhole(point, view.f, rz, held, free, w + view.c, J)

    def adjoint(self, gu: Vec2, gJ: Mat23) -> LensGradient:
        (x, y, _), (fx, fy), rz, free = self.point, self.f, self.rz, self.free
        gheld = Vec2(-rz * gJ.x.z, -rz * gJ.y.z)
        gw = each(lambda g, free, h: g + dr.select(free, h, 0), gu, free, gheld)
        gc = each(lambda g, free, h: g - dr.select(free, 0, h), gu, free, gheld)  # bounds hold -c
        by_x, by_y = x * gw.x + gJ.x.x, y * gw.y + gJ.y.y
        grz = (fx * by_x - self.held.x * gJ.x.z) + (fy * by_y - self.held.y * gJ.y.z)
        gpoint = Vec3(fx * rz * gw.x, fy * rz * gw.y, -rz * rz * grz)
        return LensGradient(gpoint, Vec2(rz * by_x, rz * by_y), gc)

    def tangent(self, dpoint: Vec3, dview: CameraArrays) -> tuple[Vec2, Mat23]:
        (x, y, _), (dx, dy, dz), (dfx, dfy) = self.point, dpoint, dview.f
        (fx, fy), rz, held = self.f, self.rz, self.held
        drz = -rz * rz * dz
        dw = Vec2(dfx * x * rz + fx * (dx * rz + x * drz), dfy * y * rz + fy * (dy * rz + y * drz))
        dheld = each(lambda free, dw, dc: dr.select(free, dw, -dc), self.free, dw, dview.c)
        dJ = Mat23(
            Vec3(dfx * rz + fx * drz, None, -(dheld.x * rz + held.x * drz)),
            Vec3(None, dfy * rz + fy * drz, -(dheld.y * rz + held.y * drz)),
        )
        return dw + dview.c, dJ


@dataclass(frozen=True)
class Ortho:
    """Parallel rays: focal lengths are pixels per metre."""

    point: Vec3
    f: Vec2
    u: Vec2
    J: Mat23

    @staticmethod
    def at(point: Vec3, view: CameraArrays) -> Ortho:
        (x, y, z), (fx, fy) = point, view.f
        u = Vec2(fx * x, fy * y) + view.c
        J = Mat23(Vec3(fx + 0 * z, None, None), Vec3(None, fy + 0 * z, None))
        return Ortho(point, view.f, u, J)

    def adjoint(self, gu: Vec2, gJ: Mat23) -> LensGradient:
        (x, y, _), (fx, fy) = self.point, self.f
        gf = Vec2(x * gu.x + gJ.x.x, y * gu.y + gJ.y.y)
        return LensGradient(Vec3(fx * gu.x, fy * gu.y, gu.x * 0), gf, gu)

    def tangent(self, dpoint: Vec3, dview: CameraArrays) -> tuple[Vec2, Mat23]:
        (x, y, _), (dx, dy, dz), (dfx, dfy) = self.point, dpoint, dview.f
        fx, fy = self.f
        du = Vec2(dfx * x + fx * dx, dfy * y + fy * dy) + dview.c
        return du, Mat23(Vec3(dfx + 0 * dz, None, None), Vec3(None, dfy + 0 * dz, None))


@dataclass(frozen=True)
class Fisheye:
    """Equidistant rays: pixels from the centre grow with the angle from the axis."""

    point: Vec3
    f: Vec2
    s: Array
    e: Array
    h: Array
    k: Array
    u: Vec2
    J: Mat23

    @staticmethod
    def at(point: Vec3, view: CameraArrays) -> Fisheye:
        (x, y, z), (fx, fy) = point, view.f
        t = x * x + y * y
        h = -1 / (t + z * z)
        s, e, k = _equidistant(t, z, h)
        exy = e * x * y
        J = Mat23(
            Vec3(fx * (s + e * x * x), fx * exy, fx * x * h),
            Vec3(fy * exy, fy * (s + e * y * y), fy * y * h),
        )
        return Fisheye(point, view.f, s, e, h, k, Vec2(fx * x * s, fy * y * s) + view.c, J)

    def adjoint(self, gu: Vec2, gJ: Mat23) -> LensGradient:
        (x, y, z), (fx, fy), s, e, h, J = self.point, self.f, self.s, self.e, self.h, self.J
        gw = Vec2(fx * gu.x, fy * gu.y)  # by w / f
        a, b = each(lambda g: fx * g, gJ.x), each(lambda g: fy * g, gJ.y)  # by the rows of J / f
        gexy = a.y + b.x
        gs = x * gw.x + y * gw.y + a.x + b.y
        ge = x * x * a.x + x * y * gexy + y * y * b.y
        gh = x * a.z + y * b.z
        gt = gs * e / 2 + ge * self.k + gh * h * h
        gpoint = Vec3(
            s * gw.x + e * (2 * x * a.x + y * gexy) + h * a.z + 2 * x * gt,
            s * gw.y + e * (2 * y * b.y + x * gexy) + h * b.z + 2 * y * gt,
            gs * h + 2 * h * h * (ge + z * gh),
        )
        gf = Vec2(s * x * gu.x + dot(J.x, gJ.x) / fx, s * y * gu.y + dot(J.y, gJ.y) / fy)
        return LensGradient(gpoint, gf, gu)

    def tangent(self, dpoint: Vec3, dview: CameraArrays) -> tuple[Vec2, Mat23]:
        (x, y, z), (dx, dy, dz), (dfx, dfy) = self.point, dpoint, dview.f
        (fx, fy), s, e, h, J = self.f, self.s, self.e, self.h, self.J
        dt = 2 * (x * dx + y * dy)
        ds, de = e / 2 * dt + h * dz, self.k * dt + 2 * h * h * dz
        dh = h * h * (dt + 2 * z * dz)
        dw = Vec2(dfx * x * s + fx * (dx * s + x * ds), dfy * y * s + fy * (dy * s + y * ds))
        # tangents of e x^2, e x y and e y^2; e x y in both orders keeps its digits
        dexx = e * (dx * x + x * dx) + de * x * x
        dexy = e * (dx * y + x * dy) + de * x * y
        deyx = e * (dy * x + y * dx) + de * y * x
        deyy = e * (dy * y + y * dy) + de * y * y
        dJ = Mat23(
            Vec3(fx * (dexx + ds), fx * dexy, fx * (dx * h + x * dh)),
            Vec3(fy * deyx, fy * (deyy + ds), fy * (dy * h + y * dh)),
        )
        by_f = Mat23(each(lambda J: dfx / fx * J, J.x), each(lambda J: dfy / fy * J, J.y))
        return dw + dview.c, dJ + by_f


# The fisheye's series in q = t / z^2, up to the q above which its formulas keep their digits.
# Chosen: the first term of s that is left out, q^12 / 25, is 2e-9 in float32, 7e-19 in float64.
SERIES_TERMS = 12
SERIES_MAX_Q = 0.25  # float32
SERIES_MAX_Q_FLOAT64 = 0.04


def _equidistant(t: Array, z: Array, h: Array) -> tuple[Array, Array, Array]:
    """Compute the fisheye's s, e and k; by series near the axis, where the formulas cancel."""
    rz = 1 / z
    q = t * rz * rz
    near = q < (SERIES_MAX_Q_FLOAT64 if packets.is_double(type(t)) else SERIES_MAX_Q)
    far = dr.select(near, 1, t)
    r = dr.sqrt(far)
    s = dr.atan2(r, z) / r
    e = (-z * h - s) / far
    k = -(z * h * h + 1.5 * e) / far
    # s z = sum (-q)^n / (2n + 1);  e = 2 s_t,  k = e_t  term by term
    terms = SERIES_TERMS
    odd = [(-1) ** n / (2 * n + 1) for n in range(terms + 2)]
    series = [
        _polynomial(q, odd[:terms]),
        _polynomial(q, [2 * n * odd[n] for n in range(1, terms + 1)]),
        _polynomial(q, [2 * n * (n - 1) * odd[n] for n in range(2, terms + 2)]),
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
