"""A lens: the adjoint is the transpose of the tangent, and the fisheye's series its formulas."""

import numpy as np
import pytest
from drjit.llvm import Float, Float64

from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels.inputs import camera_arrays, camera_tangent
from gva_mi.splat.kernels.lens import LENSES
from gva_mi.splat.kernels.vectors import Mat23, Vec2, Vec3
from gva_mi.splat.options import SplatOptions

MODELS = list(LENSES)
N = 200
T = np.array(
    [[0.8, 0.0, 0.6, 0.3], [0.0, 1.0, 0.0, -0.2], [-0.6, 0.0, 0.8, 1.5], [0.0, 0.0, 0.0, 1.0]]
)


def camera(model):
    return Camera(40.0, 45.0, 30.0, 22.0, T, 64, 48, model)


def points(seed=0, spread=2.0):
    rng = np.random.default_rng(seed)
    return [*(spread * rng.normal(size=(2, N))), rng.uniform(0.3, 3, N)]


def lens_at(model, x, F=Float64):
    view = camera_arrays(camera(model), SplatOptions()).to(F)
    return LENSES[model].at(Vec3(*(F(v) for v in x)), view)


def numbers(columns):
    """Dr.Jit variables as columns, (N, columns); a None is a zero."""
    if isinstance(columns, Mat23):
        columns = [*columns.x, *columns.y]
    full = [np.zeros(N) if c is None else np.broadcast_to(c.numpy(), N) for c in columns]
    return np.stack(full, axis=1)


@pytest.mark.parametrize("spread", [1e-9, 0.1, 3.0])
@pytest.mark.parametrize("model", MODELS)
def test_adjoint_is_the_transpose_of_the_tangent(model, spread):
    rng = np.random.default_rng(1)
    lens = lens_at(model, points(spread=spread))
    gu, gJ, dx = (rng.normal(size=(k, N)) for k in (2, 6, 3))
    gu_columns, gJ_columns = ([Float64(g) for g in part] for part in (gu, gJ))
    gJ_rows = Mat23(Vec3(*gJ_columns[:3]), Vec3(*gJ_columns[3:]))
    grad = lens.adjoint(Vec2(*gu_columns), gJ_rows)
    dT, dK = np.zeros((4, 4)), np.zeros((3, 3))
    dK[0, 0], dK[1, 1], dK[:2, 2] = 0.7, -1.1, (0.4, 1.9)
    dview = camera_tangent(camera(model), dT, dK)
    du, dJ = lens.tangent(Vec3(*(Float64(d) for d in dx)), dview)
    left = (numbers(du) * gu.T).sum() + (numbers(dJ) * gJ.T).sum()
    right = (numbers(grad.point) * dx.T).sum()
    right += (numbers(grad.f) * [0.7, -1.1]).sum() + (numbers(grad.c) * [0.4, 1.9]).sum()
    np.testing.assert_allclose(left, right, rtol=1e-12)


@pytest.mark.parametrize("F", [Float, Float64])
def test_the_fisheyes_series_agrees_with_its_formulas(F):
    """s, e and k of lens.py on both sides of where one takes over from the other."""
    edge, digits = (0.25, (1e-6, 3e-6, 3e-5)) if F is Float else (0.04, (1e-15, 1e-13, 3e-12))
    z = 1.3
    r = np.sqrt(edge * np.linspace(0.9, 1.1, N)) * z
    lens = lens_at("fisheye", [r, 0 * r, 0 * r + z], F)
    s = np.arctan2(r, z) / r
    e = (z / (r**2 + z**2) - s) / r**2
    k = -(z / (r**2 + z**2) ** 2 + 1.5 * e) / r**2
    # here e loses a factor 1/q of its digits to cancellation, and k another one
    for found, expected, rtol in zip((lens.s, lens.e, lens.k), (s, e, k), digits, strict=True):
        np.testing.assert_allclose(found.numpy(), expected, rtol=rtol)
