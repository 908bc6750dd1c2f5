"""Gaussians whose covariances are given are drawn as those with quaternions and scales."""

import gva_mi  # noqa: F401  (chooses libLLVM before Dr.Jit is imported)

from dataclasses import replace  # isort: skip

import pytest
import torch

from gva_mi.splat import Gaussians, Screen, drjit_op, quat_scale_to_covar_preci, reference, render
from gva_mi.splat.covariances import largest_scales, matrices, with_axes
from gva_mi.splat.scene import random_scene


@pytest.fixture
def scene():
    return random_scene(torch.Generator().manual_seed(3), 30, 24, 20)


def by_covars(g):
    covars, _ = quat_scale_to_covar_preci(g.quats, g.scales, compute_preci=False, triu=True)
    return replace(g, quats=None, scales=None, covars=covars)


def test_the_same_picture(scene):
    g = by_covars(scene.gaussians)
    one, other = (render(x, scene.camera, scene.options) for x in (scene.gaussians, g))
    torch.testing.assert_close(one.color, other.color, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(one.depth, other.depth, rtol=1e-9, atol=1e-9)


def test_gradients_are_those_of_the_slow_twin(scene):
    found = []
    for draw in (render, reference.render):
        g = by_covars(scene.gaussians)
        leaves = {k: v.detach().clone().requires_grad_() for k, v in g.arrays().items()}
        image = draw(Gaussians(**{"quats": None, "scales": None} | leaves), scene.camera,
                     scene.options)  # fmt: skip
        found.append(torch.autograd.grad((image.color * image.color.detach().cos()).sum(),
                                         list(leaves.values())))  # fmt: skip
    for name, a, b in zip(g.arrays(), *found, strict=True):
        assert (a - b).norm() <= 1e-9 * b.norm(), name


def test_axes_make_the_same_covariances(scene):
    g = by_covars(scene.gaussians)
    turned = with_axes(g)
    again = by_covars(turned).covars
    torch.testing.assert_close(again, g.covars, rtol=1e-9, atol=1e-15)
    assert with_axes(turned) is turned
    assert (largest_scales(g) >= largest_scales(turned) * (1 - 1e-12)).all()
    assert torch.equal(matrices(g.covars), matrices(g.covars).mT)


def test_densification_is_told_the_same(scene):
    screens = []
    for g in (scene.gaussians, by_covars(scene.gaussians)):
        means = g.means.detach().clone().requires_grad_()
        screen = Screen(absolute=True)
        image = render(replace(g, means=means), scene.camera, scene.options, screen=screen)
        image.color.sum().backward()
        screens.append(screen)
    for name in ("means2d", "radii", "grad", "absgrad"):
        one, other = (getattr(s, name).double() for s in screens)
        torch.testing.assert_close(one, other, rtol=1e-7, atol=1e-9)


def test_one_form_or_the_other(scene):
    g = scene.gaussians
    with pytest.raises(ValueError, match="either quats .* and scales .*, or covars"):
        Gaussians(g.means, g.quats, None, g.opacities, sh=g.sh, colors=g.colors)
    with pytest.raises(ValueError, match="either quats .* and scales .*, or covars"):
        replace(g, covars=by_covars(g).covars)
    with pytest.raises(ValueError, match=r"covars must be \(N, 6\), got \(30, 3\) where N is 30"):
        render(replace(by_covars(g), covars=by_covars(g).covars[:, :3]), scene.camera)


def test_dr_jit_takes_quats_and_scales(scene):
    import drjit as dr

    g = by_covars(scene.gaussians)
    tensors = {k: dr.llvm.TensorXf64(v.detach().numpy()) for k, v in g.arrays().items()}
    with pytest.raises(ValueError, match="covars are taken as torch tensors"):
        drjit_op.render(Gaussians(**{"quats": None, "scales": None} | tensors), scene.camera)
