"""``rasterization(covars=...)``: the twin's picture and gradients, without quats and scales."""

import numpy as np
import pytest
import torch

from gva_mi.splat import quat_scale_to_covar_preci, rasterization, reference
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import random_scene

W, H, N = 24, 17, 30


def scene(count=N, dtype=torch.float64):
    """Leaves by name: Gaussians, a camera."""
    g = random_scene(torch.Generator().manual_seed(3), count, W, H).gaussians
    named = {k: v for k, v in g.arrays().items()}
    named["viewmats"] = torch.tensor(look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0)))[None]
    named["Ks"] = torch.tensor(np.array([[[40.0, 0, 12.3], [0, 42, 8.1], [0, 0, 1]]]))
    return {k: v.to(dtype).clone().requires_grad_() for k, v in named.items()}


def by_covars(a, covars, **options):
    shape = {"quats": None, "scales": None, "covars": covars, "packed": False}
    return rasterization(**(a | shape), width=W, height=H, **options)


def covars_of(a):
    return quat_scale_to_covar_preci(a["quats"], a["scales"], compute_preci=False)[0]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_pictures_and_gradients_are_the_twins(model, mode):
    """Quats and scales reach every covariance: their gradients say that those by it are right."""
    a = scene()
    color, alpha, meta = by_covars(a, covars_of(a), camera_model=model, rasterize_mode=mode)
    camera = Camera.from_matrices(a["Ks"][0], a["viewmats"][0], W, H, model)
    gaussians = Gaussians(**{k: v for k, v in a.items() if k not in ("viewmats", "Ks")})
    expected = reference.render(gaussians, camera, SplatOptions(antialiased=mode != "classic"))
    weights = torch.rand(H, W, 3, generator=torch.Generator().manual_seed(0)).double()
    torch.testing.assert_close(color[0], expected.color, atol=1e-12, rtol=0)
    torch.testing.assert_close(alpha[0, ..., 0], expected.alpha, atol=1e-12, rtol=0)
    ours = torch.autograd.grad((color[0] * weights).sum(), list(a.values()))
    theirs = torch.autograd.grad((expected.color * weights).sum(), list(a.values()))
    for name, one, two in zip(a, ours, theirs, strict=True):
        two = two[:, :3] if name == "viewmats" else two
        one = one[:, :3] if name == "viewmats" else one
        torch.testing.assert_close(
            one, two, atol=1e-9, rtol=1e-9, msg=lambda m, n=name: f"{n}: {m}"
        )


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_torch_agrees_in_both_directions(mode):
    """Also where axes are equally long, and no decomposition has a derivative."""
    a = scene(5)
    covars = covars_of(a).detach()
    covars[0] = 0.02 * torch.eye(3)
    del a["quats"], a["scales"]
    names = ["means", "opacities", "viewmats"]

    def function(covars, *values):
        given = a | dict(zip(names, values, strict=True))
        return by_covars(given, covars, rasterize_mode=mode, render_mode="RGB+D")[:2]

    inputs = [covars.requires_grad_(), *(a[name] for name in names)]
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True, fast_mode=True)


def test_float32_is_near_float64_and_near_quats_and_scales():
    fine, coarse = scene(), scene(dtype=torch.float32)
    found = [by_covars(a, covars_of(a).detach().requires_grad_()) for a in (fine, coarse)]
    torch.testing.assert_close(found[1][0].double(), found[0][0], atol=2e-5, rtol=0)
    usual = rasterization(**fine, width=W, height=H, packed=False)
    torch.testing.assert_close(found[0][0], usual[0], atol=1e-12, rtol=0)
    for name in ("radii", "conics", "depths", "means2d"):
        torch.testing.assert_close(found[0][2][name], usual[2][name], atol=1e-9, rtol=1e-9)


def test_only_the_upper_triangle_is_read():
    a = scene()
    covars = covars_of(a).detach()
    lower = covars + torch.tril(torch.ones(3, 3), -1).double()
    assert torch.equal(by_covars(a, covars)[0], by_covars(a, lower)[0])
    leaf = lower.requires_grad_()
    (grad,) = torch.autograd.grad(by_covars(a, leaf)[0].sum(), leaf)
    assert (grad.tril(-1) == 0).all() and (grad[..., 0, 1] != 0).any()


def test_what_is_no_covariance_is_refused_or_harmless():
    a = scene()
    covars = covars_of(a).detach()
    with pytest.raises(ValueError, match=r"covars must be \(30, 3, 3\), got \(30, 6\)"):
        by_covars(a, torch.zeros(N, 6).double())
    with pytest.raises(ValueError, match="covars must be finite"):
        by_covars(a, covars * torch.nan)
    with pytest.raises(ValueError, match="quats must be a torch tensor, got NoneType"):
        by_covars(a, None)
    for shape in (0 * covars, -covars):
        leaf = shape.requires_grad_()
        color = by_covars(a, leaf)[0]
        assert color.isfinite().all()
        assert torch.autograd.grad(color.sum(), leaf)[0].isfinite().all()
