"""EWA projection of 3D Gaussians: forward, adjoint and tangent (paper, Eq. 1-2).

(1)      x = R m + t            mean in camera space, depth z = x_2
(2)-(3)  u, J                   position in the picture, and du/dx: lens.py
(4)-(7)  p, q, r, lo            ellipse and opacity there: ellipse.py
(8)-(10) color                  colour from spherical harmonics, if it has some: sh.py

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
from gva_mi.splat.kernels.ellipse import LN2, CovarianceEllipse, Ellipse, dot
from gva_mi.splat.kernels.inputs import (
    CameraArrays,
    Covariance,
    Gaussian3D,
    GradientMemory,
    Inputs,
    Plan,
)
from gva_mi.splat.kernels.lens import LENSES, Lens
from gva_mi.splat.kernels.records import (
    CameraGradient,
    Footprint,
    PairGradient,
    Splat,
)
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


def _in_camera(m: list[Array], view: CameraArrays) -> tuple[list[Array], Array]:
    """Eq. 1, and z; z = 1 keeps a Gaussian far before the near plane finite: it is not drawn.

    Far before it, because a Gaussian on the plane is drawn, whatever the last digit of its z.
    """
    x = [dot(view.R[3 * k : 3 * k + 3], m) + view.t[k] for k in range(3)]
    return x, dr.select(x[2] > 0.5 * view.near, x[2], 1)


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
    fine, fine_z = _in_camera([D(v) for v in g.m], exact)
    x, z, view = [F(v) for v in fine], F(fine_z), exact.to(F)
    u = [F(v) for v in LENSES[view.model].at(fine, fine_z, exact).u]
    lens = LENSES[view.model].at(x, z, view)
    e = _ellipse(lens, view, g, options)
    xx, xy, yy = e.C
    color = sh.color(g.color, g.m, view.o) if plan.harmonics else g.color

    # alpha >= alpha_min inside d^T C^-1 d <= tau: an ellipse with half extents sqrt(tau C_ii)
    tau = 2 * LN2 * (e.lo - math.log2(options.alpha_min))
    visible = (x[2] >= view.near) & (x[2] <= view.far) & (tau > 0)
    visible &= dr.isfinite(e.det) & dr.isfinite(u[0]) & dr.isfinite(u[1])
    tau = dr.select(visible, tau, 0)
    rx, ry = dr.sqrt(tau * xx), dr.sqrt(tau * yy)
    visible &= (dr.ceil(rx) > view.radius) | (dr.ceil(ry) > view.radius)
    ry = dr.select(visible, ry, -1)
    footprint = Footprint(*u, rx, ry, xy / yy, dr.sqrt(tau * e.det / yy), xy / xx * rx)

    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    radii = 3 * dr.sqrt(middle + dr.sqrt(half * half + xy * xy))
    total = sum((dr.abs(v) for v in [*g.m, *g.geometry.columns(), *g.color]), dr.abs(g.o))
    splat = Splat(u, e.L.p, e.L.q, e.L.r, e.lo, color, x[2])
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

    With the moments m1 of eq. 16:  dL/du = 2 ln2 L^T m1. Where ``target`` has no memory for
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
    where = lambda columns: [dr.select(drawn, c, 0) for c in columns]
    grad_color, toward = slot.color, [0, 0, 0]
    if plan.harmonics:
        grad_color, toward = sh.color_adjoint(g.color, g.m, view.o, slot.color)
    if target.colors is not None:
        packets.store_rows(target.colors, where(grad_color), i)
    if target.u is None:
        return

    x, z = _in_camera(g.m, view)
    lens = LENSES[view.model].at(x, z, view)
    e = _ellipse(lens, view, g, plan.options)
    k1, (mx, my) = 2 * LN2, slot.m1
    gu = [k1 * e.L.p * mx, k1 * (e.L.q * mx + e.L.r * my)]
    by_ellipse = e.adjoint(slot.m0, *slot.m2)
    by_lens = lens.adjoint(gu, by_ellipse.J)
    gx = list(by_lens.x)
    if slot.depth is not None:
        gx[2] = gx[2] + slot.depth

    # eq. 1
    R = view.R
    grad_m = [R[n] * gx[0] + R[3 + n] * gx[1] + R[6 + n] * gx[2] for n in range(3)]
    if plan.harmonics:
        grad_m = [a + b for a, b in zip(grad_m, toward, strict=True)]
    (grad_o,) = where([by_ellipse.o])
    geometry = by_ellipse.geometry.map(where)
    grad = Gaussian3D(where(grad_m), geometry, grad_o, [])
    if target.absolute is not None:
        ax, ay = slot.absolute
        packets.store_rows(target.absolute, where([k1 * e.L.p * ax, k1 * ay]), i)
    target.store(grad, where(gu), i)
    if target.camera is not None:
        gR = [gx[k] * g.m[n] for k in range(3) for n in range(3)]
        gR = [a if b is None else a + b for a, b in zip(gR, by_ellipse.R, strict=True)]
        go = [0 * gx[0] - v for v in toward]
        parts = (gR, gx, by_lens.f, by_lens.c, go)
        packets.store(target.camera, CameraGradient(*map(where, parts)), i)


def project_tangent(
    inputs: Inputs, plan: Plan, view: CameraArrays, dinputs: Inputs, dview: CameraArrays
) -> Splat:
    """Tangent of :func:`project`'s splat along the tangents of the Gaussians and the camera."""
    i, F = inputs.index(), inputs.float_type
    view, dview = view.to(F), dview.to(F)
    g, d = (Gaussian3D.load(source, plan.color_width, i) for source in (inputs, dinputs))
    x, z = _in_camera(g.m, view)
    dx = [
        dot(view.R[3 * k : 3 * k + 3], d.m) + dot(dview.R[3 * k : 3 * k + 3], g.m) + dview.t[k]
        for k in range(3)
    ]
    lens = LENSES[view.model].at(x, z, view)
    du, dJ = lens.tangent(dx, dview)
    e = _ellipse(lens, view, g, plan.options)
    dp, dq, dr_, dlo = e.tangent(dJ, dview.R, d.geometry, d.o)
    dcolor = d.color
    if plan.harmonics:
        dcolor = sh.color_tangent(g.color, g.m, view.o, d.color, d.m, dview.o)
    return Splat(du, dp, dq, dr_, dlo, dcolor, dx[2])
