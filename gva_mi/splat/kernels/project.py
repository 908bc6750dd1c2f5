"""A 3D Gaussian in the picture: EWA projection, forward, adjoint and tangent (paper, Eq. 1-2).

(1)  x = R m + t                mean in camera space, depth z = x_2
(2)  u, (3) J                   where it falls in the picture, and du/dx: lens.py
(4)-(7)  p, q, r, lo            its ellipse and opacity there: ellipse.py
     f                          its features: the D channels of its colour (plain, or by sh.py), z

Each of the three directions below is one kernel, lane per Gaussian, that calls the same direction
of the parts named on the right.

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
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets, sh
from gva_mi.splat.kernels.ellipse import LN2, Ellipse, dot
from gva_mi.splat.kernels.lens import LENSES, View
from gva_mi.splat.options import SplatOptions

GEOMETRY = 6  # columns of a projected Gaussian before its features: u_0, u_1, p, q, r, lo
MOMENTS = 6  # columns of an adjoint slot before the features: see blend.py, eq. 6


@dataclass(frozen=True)
class Inputs:
    """What is differentiated, as flat Dr.Jit arrays of one precision; also its tangents."""

    means: Array  # 3 N
    quats: Array  # 4 N
    scales: Array  # 3 N
    opacities: Array  # N
    colors: Array  # D N features, or 3 K N coefficients


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


def _lane(inputs: Inputs) -> Array:
    return dr.arange(dr.uint32_array_t(type(inputs.means)), dr.width(inputs.opacities))


def _in_camera(m: list[Array], view: View, near: float) -> tuple[list[Array], Array]:
    """Eq. 1, and z; a Gaussian before the near plane is not drawn, and z = 1 keeps it finite."""
    x = [dot(view.R[3 * k : 3 * k + 3], m) + view.t[k] for k in range(3)]
    return x, dr.select(x[2] > near, x[2], 1)


def project(
    inputs: Inputs, width: int, harmonics: bool, exact: View, options: SplatOptions
) -> tuple[list[Array], Ellipses, Array, Array]:
    """Eq. 1-7 for every Gaussian.

    Args:
        inputs: the Gaussians.
        width: columns of ``inputs.colors``: D, or 3 K where ``harmonics``.
        harmonics: whether the colours are coefficients.
        exact: the camera, in float64: u is a small difference of large numbers, and its rounding
            is the largest of all errors of a float32 picture. So eq. 1-2 are float64 throughout.
        options: cut-offs.

    Returns:
        The GEOMETRY columns and behind them the features, colour then depth; the ellipses; three
        standard deviations along the longer axis, px; whether all inputs are finite.
    """
    F, D = type(inputs.means), dr.float64_array_t(type(inputs.means))
    g = _columns(inputs, width, _lane(inputs))
    fine, fine_z = _in_camera([D(v) for v in g.m], exact, options.near)
    x, z, view = [F(v) for v in fine], F(fine_z), exact.to(F)
    u = [F(v) for v in LENSES[view.model].at(fine, fine_z, exact).u]
    lens = LENSES[view.model].at(x, z, view)
    e = Ellipse.of(lens.J, view.R, g.quat, g.s, g.o, options)
    xx, xy, yy = e.C
    features = sh.color(g.h, g.m, view.o) if harmonics else g.h

    # alpha >= alpha_min inside d^T C^-1 d <= tau: an ellipse with half extents sqrt(tau C_ii)
    tau = 2 * LN2 * (e.lo - math.log2(options.alpha_min))
    visible = (x[2] > options.near) & (x[2] < options.far) & (tau > 0)
    visible &= dr.isfinite(e.det) & dr.isfinite(u[0]) & dr.isfinite(u[1])
    tau = dr.select(visible, tau, 0)
    rx, ry = dr.sqrt(tau * xx), dr.sqrt(tau * yy)
    if options.radius_min > 0:
        visible &= (dr.ceil(rx) > options.radius_min) | (dr.ceil(ry) > options.radius_min)
    ry = dr.select(visible, ry, -1)
    ellipses = Ellipses(*u, rx, ry, xy / yy, dr.sqrt(tau * e.det / yy), xy / xx * rx)

    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    radii = 3 * dr.sqrt(middle + dr.sqrt(half * half + xy * xy))
    finite = dr.isfinite(sum((dr.abs(v) for v in [*g.m, *g.quat, *g.s, *g.h]), dr.abs(g.o)))
    return [*u, e.p, e.q, e.r, e.lo, *features, x[2]], ellipses, radii, finite


@dataclass(frozen=True)
class Targets:
    """Memory for the gradients of :func:`project_adjoint`; None for one that nobody asked for."""

    inputs: Inputs
    u: Array  # 2 N, by the mean in the picture, per px
    absolute: Array | None  # 2 N, the same with every pixel's share taken absolutely
    view: packets.Packets | None  # View.DIFFERENTIABLE columns: each Gaussian's share


def project_adjoint(
    inputs: Inputs,
    width: int,
    harmonics: bool,
    view: View,
    options: SplatOptions,
    moments: list[Array],
    drawn: Array,
    target: Targets,
    through_u: bool = True,
) -> None:
    """Eq. 1-7 reversed, for every Gaussian.

    With the moments m1 of blend.py, eq. 6:  dL/du = 2 ln2 L^T m1.

    Args:
        inputs, width, harmonics, view, options: as :func:`project` took them.
        moments: blend.py, eq. 6: MOMENTS columns, two more for ``target.absolute``, the gradients
            of the colour's channels and, if the loss looks at it, that of the depth.
        drawn: False where a Gaussian has no pairs, and so no gradient.
        target: where the gradients go.
        through_u: whether dL/du takes part in the other gradients; not where the caller has
            made u a node of its own graph.
    """
    i = _lane(inputs)
    view = view.to(type(inputs.means))
    m0, mx, my, mxx, mxy, myy, *grad_f = moments
    g = _columns(inputs, width, i)
    x, z = _in_camera(g.m, view, options.near)
    lens = LENSES[view.model].at(x, z, view)
    e = Ellipse.of(lens.J, view.R, g.quat, g.s, g.o, options)

    k1 = 2 * LN2
    gu = [k1 * e.p * mx, k1 * (e.q * mx + e.r * my)]
    if target.absolute is not None:
        ax, ay, *grad_f = grad_f
        packets.store_rows(target.absolute, _where(drawn, [k1 * e.p * ax, k1 * ay]), i)
    by_ellipse = e.adjoint(m0, mxx, mxy, myy)
    by_lens = lens.adjoint(gu if through_u else [0 * gu[0], 0 * gu[1]], by_ellipse.J)
    gx = list(by_lens.x)
    if len(grad_f) > (3 if harmonics else width):
        gx[2] = gx[2] + grad_f.pop()

    # eq. 1
    R = view.R
    grad_m = [R[n] * gx[0] + R[3 + n] * gx[1] + R[6 + n] * gx[2] for n in range(3)]
    grad_h, toward = grad_f, [0, 0, 0]
    if harmonics:
        grad_h, toward = sh.color_adjoint(g.h, g.m, view.o, grad_f)
        grad_m = [a + b for a, b in zip(grad_m, toward, strict=True)]

    mode = dr.ReduceMode.NoConflicts
    for k in range(3):
        dr.scatter(target.inputs.means, _where(drawn, grad_m)[k], 3 * i + k, mode=mode)
        dr.scatter(target.inputs.scales, _where(drawn, by_ellipse.s)[k], 3 * i + k, mode=mode)
    packets.store_rows(target.inputs.quats, _where(drawn, by_ellipse.quat), i)
    packets.store_rows(target.inputs.colors, _where(drawn, grad_h), i)
    packets.store_rows(target.u, _where(drawn, gu), i)
    dr.scatter(target.inputs.opacities, _where(drawn, [by_ellipse.o])[0], i, mode=mode)
    if target.view is not None:
        gR = [gx[k] * g.m[n] for k in range(3) for n in range(3)]
        gR = [a if b is None else a + b for a, b in zip(gR, by_ellipse.R, strict=True)]
        shares = [*gR, *gx, *by_lens.f, *by_lens.c, *(0 * gx[0] - v for v in toward)]
        packets.store(target.view, _where(drawn, shares), i)


def _where(drawn: Array, columns: list[Array]) -> list[Array]:
    return [dr.select(drawn, c, 0) for c in columns]


def project_tangent(
    inputs: Inputs,
    width: int,
    harmonics: bool,
    view: View,
    options: SplatOptions,
    dinputs: Inputs,
    dview: View,
) -> list[Array]:
    """Tangents of :func:`project`'s columns along those of the Gaussians and of the camera."""
    i = _lane(inputs)
    view, dview = view.to(type(inputs.means)), dview.to(type(inputs.means))
    g, d = _columns(inputs, width, i), _columns(dinputs, width, i)
    x, z = _in_camera(g.m, view, options.near)
    dx = [
        dot(view.R[3 * k : 3 * k + 3], d.m) + dot(dview.R[3 * k : 3 * k + 3], g.m) + dview.t[k]
        for k in range(3)
    ]
    lens = LENSES[view.model].at(x, z, view)
    du, dJ = lens.tangent(dx, dview)
    e = Ellipse.of(lens.J, view.R, g.quat, g.s, g.o, options)
    shape = e.tangent(dJ, dview.R, d.quat, d.s, d.o)
    df = d.h
    if harmonics:
        df = sh.color_tangent(g.h, g.m, view.o, d.h, d.m, dview.o)
    return [*du, *shape, *df, dx[2]]
