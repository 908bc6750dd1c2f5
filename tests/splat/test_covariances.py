"""Gaussians given by covariances, against the reference and against quaternions and scales."""

from dataclasses import replace

import pytest
import torch
from samples.scenes import in_drjit

from gva_mi.splat import Gaussians, drjit_render, rasterization, reference, render
from gva_mi.splat.axes import matrices, with_axes
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import random_scene

ROWS, COLUMNS = torch.triu_indices(3, 3)


@pytest.fixture
def scene():
    return random_scene(torch.Generator().manual_seed(3), 30, 24, 20)


def sigma(g):
    """Covariances (N, 3, 3) of quaternions and scales."""
    M = torch.stack([reference.rotation(q) for q in g.quats])
    A = M * g.scales[:, None]
    return A @ A.mT


def by_covars(g):
    return replace(g, quats=None, scales=None, covars=sigma(g)[:, ROWS, COLUMNS])


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_pictures_and_gradients_match_the_reference(scene, model, antialiased):
    scene, options = scene.through(model), SplatOptions(antialiased=antialiased)
    found, g = [], by_covars(scene.gaussians)
    for draw in (render, reference.render):
        leaves = {k: v.detach().clone().requires_grad_() for k, v in g.arrays().items()}
        image = draw(Gaussians(**{"quats": None, "scales": None} | leaves), scene.camera, options)
        loss = image.color.square().sum() + image.depth.sum()
        found.append((image.color, *torch.autograd.grad(loss, list(leaves.values()))))
    for name, a, b in zip(("color", *g.arrays()), *found, strict=True):
        assert (a - b).norm() <= 1e-9 * b.norm(), name


@pytest.mark.parametrize("antialiased", [False, True])
def test_torchs_gradcheck_agrees_in_both_modes(antialiased):
    """Also where two axes are equally long, and no decomposition has a derivative."""
    s = random_scene(torch.Generator().manual_seed(3), 5, 12, 10)
    g = by_covars(s.gaussians)
    g.covars[0] = 0.02 * torch.eye(3)[ROWS, COLUMNS]

    def draw(covars, means, opacities):
        moved = replace(g, covars=covars, means=means, opacities=opacities)
        image = render(moved, s.camera, SplatOptions(antialiased=antialiased))
        return image.color, image.alpha, image.depth

    inputs = [x.clone().requires_grad_() for x in (g.covars, g.means, g.opacities)]
    assert torch.autograd.gradcheck(draw, inputs, check_forward_ad=True, fast_mode=True)


def by_rasterization(scene, covars):
    g, camera = scene.gaussians, scene.camera
    T, K = (torch.tensor(x)[None] for x in (camera.T_camera_world, camera.K))
    size = (camera.width, camera.height)
    found = rasterization(g.means, None, None, g.opacities, g.colors, T, K, *size, covars=covars)
    return found[0]


def test_matrices_that_are_no_covariances_are_refused_or_harmless(scene):
    covars = sigma(scene.gaussians)
    with pytest.raises(ValueError, match=r"covars must be \(30, 3, 3\), got \(30, 6\)"):
        by_rasterization(scene, torch.zeros(30, 6).double())
    with pytest.raises(ValueError, match="covars must be finite"):
        by_rasterization(scene, covars * torch.nan)
    with pytest.raises(ValueError, match="quats must be a torch tensor, got NoneType"):
        by_rasterization(scene, None)
    for shape in (0 * covars, -covars):
        leaf = shape.requires_grad_()
        color = by_rasterization(scene, leaf)
        assert color.isfinite().all()
        assert torch.autograd.grad(color.sum(), leaf)[0].isfinite().all()


def test_axes_make_the_same_covariances(scene):
    g = by_covars(scene.gaussians)
    turned = with_axes(g)
    torch.testing.assert_close(by_covars(turned).covars, g.covars, rtol=1e-9, atol=1e-15)
    assert with_axes(turned) is turned
    assert torch.equal(matrices(g.covars), sigma(scene.gaussians))


def test_gaussians_have_one_form_or_the_other(scene):
    g = scene.gaussians
    with pytest.raises(ValueError, match="either quats .* and scales .*, or covars"):
        Gaussians(g.means, g.quats, None, g.opacities, sh=g.sh, colors=g.colors)
    with pytest.raises(ValueError, match="either quats .* and scales .*, or covars"):
        replace(g, covars=by_covars(g).covars)
    with pytest.raises(ValueError, match=r"covars must be \(N, 6\), got \(30, 3\) where N is 30"):
        render(replace(by_covars(g), covars=by_covars(g).covars[:, :3]), scene.camera)
    infinite = by_covars(g)
    infinite.covars[7, 1] = torch.inf
    with pytest.raises(ValueError, match=r"covars\[7, 1\] is inf, must be finite"):
        render(infinite, scene.camera)


def test_drjit_takes_covariances(scene):
    from drjit.llvm import TensorXf64

    g = by_covars(scene.gaussians)
    image = drjit_render.render(in_drjit(g, TensorXf64), scene.camera)
    assert (image.color.numpy() == render(g, scene.camera).color.numpy()).all()


def test_rasterization_reads_only_the_upper_triangle(scene):
    g, camera = scene.gaussians, scene.camera
    covars = sigma(g)
    lower = (covars + torch.tril(torch.ones(3, 3), -1).double()).requires_grad_()
    view = torch.tensor(camera.T_camera_world)[None], torch.tensor(camera.K)[None]
    color = rasterization(g.means, None, None, g.opacities, g.colors, *view, camera.width,
        camera.height, covars=lower)[0]  # fmt: skip
    torch.testing.assert_close(color[0], render(by_covars(g), camera).color, atol=0, rtol=0)
    (grad,) = torch.autograd.grad(color.sum(), lower)
    assert (grad.tril(-1) == 0).all() and (grad[..., 0, 1] != 0).any()
