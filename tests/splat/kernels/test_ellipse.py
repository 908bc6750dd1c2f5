"""L^T L is the inverse covariance; the adjoint is the transpose of the tangent."""

import math

import numpy as np
import pytest
import torch
from drjit.llvm import Float64

from gva_mi.splat import reference
from gva_mi.splat.kernels.ellipse import Ellipse
from gva_mi.splat.kernels.inputs import QuatScale
from gva_mi.splat.kernels.vectors import Mat3, Mat23, Quat, Sym2, Vec3
from gva_mi.splat.options import SplatOptions

N = 100


def columns(rng, count):
    return list(rng.normal(size=(count, N)))


def inputs(seed=0):
    rng = np.random.default_rng(seed)
    J, R, quat = columns(rng, 6), columns(rng, 9), columns(rng, 4)
    return J, R, quat, list(np.exp(rng.normal(size=(3, N)))), rng.uniform(0.1, 1, N)


def wrap(parts):
    J, R, quat, s = ([Float64(c) for c in part] for part in parts[:4])
    J, geometry = Mat23(Vec3(*J[:3]), Vec3(*J[3:])), QuatScale(Quat(*quat), Vec3(*s))
    return J, Mat3.of(R), geometry, Float64(parts[4])


def ellipse(parts, antialiased=False):
    options = SplatOptions(antialiased=antialiased)
    return Ellipse.of(*wrap(parts), Float64(options.blur), options)


def stack(values):
    return np.stack([v.numpy() for v in values])


@pytest.mark.parametrize("antialiased", [False, True])
def test_factor_and_opacity(antialiased):
    parts = inputs()
    e = ellipse(parts, antialiased)
    J, R, quat, s, o = (torch.tensor(np.stack(p, axis=-1)) for p in parts)
    for i in range(N):
        V = J[i].view(2, 3) @ R[i].view(3, 3) @ reference.rotation(quat[i]) @ torch.diag(s[i])
        sharp = V @ V.T
        C = sharp + 0.3 * torch.eye(2, dtype=torch.float64)
        p, q, r = (getattr(e.L, name).numpy()[i] for name in "pqr")
        L = np.array([[p, q], [0, r]])
        expected = torch.linalg.inv(C).numpy() / (2 * math.log(2))
        np.testing.assert_allclose(L.T @ L, expected, rtol=1e-10, atol=1e-14)
        rho = math.sqrt(torch.linalg.det(sharp) / torch.linalg.det(C)) if antialiased else 1
        np.testing.assert_allclose(e.lo.numpy()[i], math.log2(o[i] * rho), rtol=1e-9)


@pytest.mark.parametrize("antialiased", [False, True])
def test_adjoint_is_the_transpose_of_the_tangent(antialiased):
    """The adjoint starts from moments; those of one pixel at d with weight v are v w w^T."""
    parts, rng = inputs(), np.random.default_rng(1)
    e = ellipse(parts, antialiased)
    tangents = [columns(rng, 6), columns(rng, 9), columns(rng, 4), columns(rng, 3)]
    tangents.append(rng.normal(size=N))
    dp, dq, dr, dlo = stack(e.tangent(*wrap(tangents)))
    v, dx, dy = rng.normal(size=(3, N))
    p, q, r = (getattr(e.L, name).numpy() for name in "pqr")
    wx, wy = p * dx + q * dy, r * dy
    # ln alpha = ln2 (lo - |w|^2): its tangent at a fixed d, weighted by v
    left = v * math.log(2) * (dlo - 2 * (wx * (dp * dx + dq * dy) + wy * dr * dy))
    m2 = Sym2(*(Float64(m) for m in (v * wx * wx, v * wx * wy, v * wy * wy)))
    g = e.adjoint(Float64(v), m2)
    found = [*g.J.x, *g.J.y], g.R.flat(), g.geometry.quats, g.geometry.scales
    pairs = zip(found, tangents, strict=False)
    right = sum((stack(a) * np.stack(b)).sum(axis=0) for a, b in pairs)
    right += g.o.numpy() * tangents[4]
    np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-10)
