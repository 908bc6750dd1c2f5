"""A depth limit per pixel hides the Gaussians behind an opaque surface."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
from drjit.llvm.ad import TensorXf, TensorXf64

from gva_mi.splat import Camera, Gaussians, look_at
from gva_mi.splat.drjit_render import render

WIDTH, HEIGHT = 37, 30
CAMERA = Camera(40, 40, 18.5, 15, look_at((0, 0, 4), (0, 0, 0)), WIDTH, HEIGHT)
LIMITS = (0.0, 3.9, 4.3, np.inf)  # m; the Gaussians lie between 3 and 5
IMAGES = ("color", "alpha", "depth")


def arrays(n=60, channels=3):
    rng = np.random.default_rng(1)
    return {"means": rng.uniform(-1, 1, (n, 3)), "quats": rng.normal(size=(n, 4)),
        "scales": rng.uniform(0.05, 0.3, (n, 3)), "opacities": rng.uniform(0.2, 0.9, n),
        "colors": rng.uniform(size=(n, channels))}  # fmt: skip


def gaussians(kind, rows=slice(None), channels=3):
    return Gaussians(**{n: kind(array[rows]) for n, array in arrays(channels=channels).items()})


def limit():
    """All of LIMITS, side by side in slanted strips that cut through tiles."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.array(LIMITS)[np.clip((x + y // 5) // 11, 0, 3)]


@pytest.mark.parametrize("channels", [3, 20])  # 20: more than are composited at a time
@pytest.mark.parametrize("kind", [TensorXf, TensorXf64])
def test_a_pixel_shows_exactly_the_gaussians_before_its_limit(kind, channels):
    image = render(gaussians(kind, channels=channels), CAMERA, depth_limit=kind(limit()))
    depths = 4 - arrays()["means"][:, 2]
    for z in LIMITS:
        alone = render(gaussians(kind, depths < z, channels), CAMERA)
        for name in IMAGES:
            got, expected = (getattr(i, name).numpy()[limit() == z] for i in (image, alone))
            np.testing.assert_array_equal(got, expected)


def test_adjoint_and_tangent_agree_and_match_the_difference():
    rng = np.random.default_rng(3)
    kind = TensorXf64
    weights = [kind(rng.normal(size=s)) for s in ((HEIGHT, WIDTH, 3),) + 2 * ((HEIGHT, WIDTH),)]
    moves = {name: 0.1 * rng.normal(size=a.shape) for name, a in arrays().items()}

    def loss(moved):
        image = render(
            Gaussians(**moved), CAMERA, background=kind([0.2, 0.5, 0.7]), depth_limit=kind(limit())
        )
        parts = zip(weights, IMAGES, strict=True)
        return sum(dr.sum(w * getattr(image, name), axis=None) for w, name in parts)

    def along(t):
        return loss({name: kind(a) + t * kind(moves[name]) for name, a in arrays().items()})

    leaves = {name: kind(a) for name, a in arrays().items()}
    dr.enable_grad(leaves)
    dr.backward(loss(leaves))
    adjoint = sum((dr.grad(leaves[name]).numpy() * moves[name]).sum() for name in moves)
    t = dr.opaque(dr.array_t(kind), 0)
    dr.enable_grad(t)
    value = along(t)
    dr.forward(t)
    tangent = dr.grad(value).numpy().item()
    e = 1e-6
    difference = (along(kind([e])) - along(kind([-e]))).numpy().item() / (2 * e)
    assert tangent == pytest.approx(adjoint, rel=1e-11)
    assert tangent == pytest.approx(difference, rel=1e-6)


def test_a_limit_of_another_size_is_refused():
    camera = replace(CAMERA, width=WIDTH + 1)
    with pytest.raises(ValueError, match="depth_limit"):
        render(gaussians(TensorXf), camera, depth_limit=TensorXf(limit()))
