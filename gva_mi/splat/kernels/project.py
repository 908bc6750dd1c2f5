"""EWA projection of 3D Gaussians: forward, adjoint and tangent (paper, Eq. 1-2).

(1)      (x, y, z) = R m + t    mean in camera space, depth z
(2)-(3)  u, J                   position in the picture, and du/d(x, y, z): lens.py
(4)-(7)  p, q, r, lo            ellipse and opacity there: ellipse.py
(8)-(10) color                  colour, from spherical harmonics if given: sh.py

The equations continue in pixel.py. Each of the three functions below is one kernel with one lane
per Gaussian; it calls the same function of the files on the right.

| paper | code | shape | unit |
|---|---|---|---|
| mu | ``means`` m | (N, 3) | m, world |
| q, s | ``quats``, ``scales`` | (N, 4), (N, 3) | wxyz; m |
| alpha_i | ``opacities`` o | (N,) | |
| c | ``colors`` | (N, D) or (N, 3 K) | channels, or coefficients |
| W | ``T_camera_world`` = [R, t] | (4, 4) | |
| mu' | ``u`` | (N, 2) | px |
| Sigma' | ``C`` = [[c_xx, c_xy], [c_xy, c_yy]] | (N, 2, 2) | px^2 |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels import sh
from gva_mi.splat.kernels.ellipse import CovarianceEllipse, Ellipse
from gva_mi.splat.kernels.inputs import (
    CameraArrays,
    Covariance,
    Gaussian3D,
    GradientMemory,
    Inputs,
    Plan,
)
from gva_mi.splat.kernels.lens import LENSES, Lens
from gva_mi.splat.kernels.pixel import LN2
from gva_mi.splat.kernels.records import CameraGradient, Footprint, PairGradient, Splat
from gva_mi.splat.kernels.vectors import Vec2, Vec3, apply, each, outer
from gva_mi.splat.options import SplatOptions


@dataclass(frozen=True)
class ProjectedGaussians:
    """Every Gaussian in the picture, in a kernel: (N,) each."""

    splat: Splat  # all channels of the colour, and the depth
    footprint: Footprint
    radii: Array  # px, three standard deviations along the longer axis
    finite: Array  # whether all its numbers are finite


@dataclass(frozen=True)
class ProjectedMemory:
    """Every Gaussian in the picture, in memory: the input of the next kernels.

    Splats and footprints have unused memory behind the last Gaussian.
    """

    splats: list[packets.Packets]  # one per chunk; read by blend.py
    footprints: packets.Packets  # read by tiles.py
    depths: Array  # (N,) m
    counts: Array  # (N,) tiles touched
    radii: Array  # (N,) px, 3 sigma along the longer axis; 0 where not drawn
    boxed: Array  # (N,) whether its bounding box in whole pixels overlaps the picture
    finite: Array  # (N,)


def _in_camera(m: Vec3, view: CameraArrays) -> tuple[Vec3, Array]:
    """Eq. 1, with z = 1 for a Gaussian far before the near plane; and z itself.

    It is not drawn, and z = 1 keeps it finite. Far before the plane, because a Gaussian on it is
    drawn, whatever the last digit of its z.
    """
    x, y, z = apply(view.R, m) + view.t
    return Vec3(x, y, dr.select(z > 0.5 * view.near, z, 1)), z


def _ellipse(
    lens: Lens, view: CameraArrays, g: Gaussian3D, options: SplatOptions
) -> Ellipse | CovarianceEllipse:
    """Eq. 4-7, for the form in which the covariance is given."""
    kind = CovarianceEllipse if isinstance(g.geometry, Covariance) else Ellipse
    return kind.of(lens.J, view.R, g.geometry, g.o, view.blur, options)


def project(inputs: Inputs, plan: Plan, exact: CameraArrays) -> ProjectedGaussians:
    """Eq. 1-10 for every Gaussian.

    Args:
        inputs: the Gaussians.
        plan: cut-offs, and the kind of the colours.
        exact: the camera, in float64: u is a small difference of large numbers, and its rounding
            would be the largest error of a float32 picture. So eq. 1-2 are computed in float64.
    """
    options, F = plan.options, inputs.float_type
    D = dr.float64_array_t(F)
    g = Gaussian3D.load(inputs, plan.color_width, inputs.index())
    fine, fine_z = _in_camera(each(D, g.m), exact)
    point, z, view = each(F, fine), F(fine_z), exact.to(F)
    u = each(F, LENSES[view.model].at(fine, exact).u)
    lens = LENSES[view.model].at(point, view)
    e = _ellipse(lens, view, g, options)
    xx, xy, yy = e.C
    color = sh.color(g.color, g.m, view.o) if plan.harmonics else g.color

    # alpha >= alpha_min inside d^T C^-1 d <= tau: an ellipse with half extents sqrt(tau C_ii)
    tau = 2 * LN2 * (e.lo - math.log2(options.alpha_min))
    visible = (z >= view.near) & (z <= view.far) & (tau > 0)
    visible &= dr.isfinite(e.det) & dr.isfinite(u.x) & dr.isfinite(u.y)
    tau = dr.select(visible, tau, 0)
    rx, ry = dr.sqrt(tau * xx), dr.sqrt(tau * yy)
    visible &= (dr.ceil(rx) > view.radius) | (dr.ceil(ry) > view.radius)
    ry = dr.select(visible, ry, -1)
    footprint = Footprint(*u, rx, ry, xy / yy, dr.sqrt(tau * e.det / yy), xy / xx * rx)

    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    radii = 3 * dr.sqrt(middle + dr.sqrt(half * half + xy * xy))
    total = sum((dr.abs(v) for v in [*g.m, *g.geometry.numbers(), *g.color]), dr.abs(g.o))
    splat = Splat(u, e.L.p, e.L.q, e.L.r, e.lo, color, z)
    return ProjectedGaussians(splat, footprint, radii, dr.isfinite(total))


def project_adjoint(
    inputs: Inputs,
    plan: Plan,
    view: CameraArrays,
    slot: PairGradient,
    drawn: Array,
    target: GradientMemory,
) -> None:
    """Eq. 1-10 reversed, for every Gaussian.

    With the moments m1 of eq. 16:  dℓ/du = 2 ln2 L^T m1. Where ``target`` has no memory for
    geometry, only the gradient of the colours is computed.

    Args:
        inputs, plan, view: as :func:`project` took them.
        slot: the sums of eq. 16 over the Gaussian's pairs, for all channels of the colour.
        drawn: False where a Gaussian has no pairs, and therefore no gradient.
        target: memory for the gradients.
    """
    i = inputs.index()
    view = view.to(inputs.float_type)
    g = Gaussian3D.load(inputs, plan.color_width, i)
    if_drawn = lambda number: dr.select(drawn, number, 0)
    grad_color, by_direction = slot.color, Vec3(0, 0, 0)
    if plan.harmonics:
        grad_color, by_direction = sh.color_adjoint(g.color, g.m, view.o, slot.color)
    if target.colors is not None:
        packets.store_rows(target.colors, [if_drawn(c) for c in grad_color], i)
    if target.u is None:
        return

    point, _ = _in_camera(g.m, view)
    lens = LENSES[view.model].at(point, view)
    e = _ellipse(lens, view, g, plan.options)
    k1, m1, L = 2 * LN2, slot.m1, e.L
    gu = Vec2(k1 * L.p * m1.x, k1 * (L.q * m1.x + L.r * m1.y))
    by_ellipse = e.adjoint(slot.m0, slot.m2)
    by_lens = lens.adjoint(gu, by_ellipse.J)
    gpoint = by_lens.point
    if slot.depth is not None:
        gpoint = gpoint._replace(z=gpoint.z + slot.depth)

    # eq. 1
    grad_m = apply(view.R.T, gpoint)
    if plan.harmonics:
        grad_m = grad_m + by_direction
    geometry = by_ellipse.geometry.map(if_drawn)
    grad = Gaussian3D(each(if_drawn, grad_m), geometry, if_drawn(by_ellipse.o), [])
    if target.absolute is not None:
        by_u = Vec2(k1 * L.p * slot.absolute.x, k1 * slot.absolute.y)
        packets.store_rows(target.absolute, each(if_drawn, by_u), i)
    target.store(grad, each(if_drawn, gu), i)
    if target.camera is not None:
        gR = outer(gpoint, g.m) + by_ellipse.R
        go = each(lambda v: 0 * gpoint.x - v, by_direction)
        parts = (gR, gpoint, by_lens.f, by_lens.c, go)
        packets.store(target.camera, CameraGradient(*(each(if_drawn, v) for v in parts)), i)


def project_tangent(
    inputs: Inputs, plan: Plan, view: CameraArrays, dinputs: Inputs, dview: CameraArrays
) -> Splat:
    """Tangent of :func:`project`'s splat along the tangents of the Gaussians and the camera."""
    i, F = inputs.index(), inputs.float_type
    view, dview = view.to(F), dview.to(F)
    g, d = (Gaussian3D.load(source, plan.color_width, i) for source in (inputs, dinputs))
    point, _ = _in_camera(g.m, view)
    dpoint = apply(view.R, d.m) + apply(dview.R, g.m) + dview.t
    lens = LENSES[view.model].at(point, view)
    du, dJ = lens.tangent(dpoint, dview)
    e = _ellipse(lens, view, g, plan.options)
    dp, dq, dr_, dlo = e.tangent(dJ, dview.R, d.geometry, d.o)
    dcolor = d.color
    if plan.harmonics:
        dcolor = sh.color_tangent(g.color, g.m, view.o, d.color, d.m, dview.o)
    return Splat(du, dp, dq, dr_, dlo, dcolor, dpoint.z)
