"""Forward mode: the tangent is the adjoint's transpose, and agrees with differences."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch
from drjit.llvm import ad
from torch.autograd import forward_ad

from gva_mi.gradcheck import random_scene
from gva_mi.splat import reference
from gva_mi.splat.camera import Camera
from gva_mi.splat.drjit_render import render as native
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_render import render

WIDE = np.eye(4)
WIDE[:3, 3] = (0.1, -0.1, 0.9)  # amid the Gaussians: wide angles
CAMERAS = {
    "pinhole": lambda c: c,
    "ortho": lambda c: replace(c, model="ortho", fx=c.width / 2.2, fy=c.width / 2),
    "fisheye": lambda c: Camera(
        c.width / 1.6, c.width / 1.5, c.cx, c.cy, WIDE, c.width, c.height, "fisheye"
    ),
}
KINDS = {"colors": {}, "sh 3": {"degree": 3}, "wide": {"channels": 11}}


def case(model, antialiased=False, **kwargs):
    """Return all differentiable inputs by name, and the images as a function of them."""
    s = random_scene(torch.Generator().manual_seed(1), **kwargs)
    camera = CAMERAS[model](s.camera)
    options = SplatOptions(antialiased=antialiased)
    inputs = {k: v.detach() for k, v in s.inputs().items()}
    inputs |= {"T_camera_world": torch.tensor(camera.T_camera_world), "K": torch.tensor(camera.K)}

    def images(draw, inputs):
        inputs = dict(inputs)
        matrices = {k: inputs.pop(k) for k in ("T_camera_world", "K")}
        moved = s.with_inputs(inputs)
        view = camera.with_matrices(**matrices)
        image = draw(moved.gaussians, view, options, moved.background)
        return image.color, image.alpha, image.depth

    return inputs, images


def like(tensors, seed):
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(t.shape, generator=generator, dtype=torch.float64) for t in tensors]


def assert_transposed(images, inputs, draw=render):
    leaves = {k: v.clone().requires_grad_() for k, v in inputs.items()}
    out = images(draw, leaves)
    w, v = like(out, 2), dict(zip(inputs, like(inputs.values(), 3), strict=True))
    gradients = torch.autograd.grad(out, list(leaves.values()), w)
    right = sum((g * d).sum() for g, d in zip(gradients, v.values(), strict=True))
    with forward_ad.dual_level():
        out = images(draw, {k: forward_ad.make_dual(x, v[k]) for k, x in inputs.items()})
        left = sum(
            (forward_ad.unpack_dual(o).tangent * d).sum() for o, d in zip(out, w, strict=True)
        )
    torch.testing.assert_close(left, right, rtol=1e-12, atol=0)
    return dict(zip(leaves, gradients, strict=True))


@pytest.mark.parametrize(
    ("kind", "antialiased"), [("colors", True), ("sh 3", False), ("sh 3", True), ("wide", False)]
)
@pytest.mark.parametrize("model", CAMERAS)
def test_tangents_transpose_adjoints_which_match_the_reference(kind, model, antialiased):
    inputs, images = case(model, antialiased, **KINDS[kind])
    found = assert_transposed(images, inputs)
    leaves = {k: v.clone().requires_grad_() for k, v in inputs.items()}
    out = images(reference.render, leaves)
    assert (out[1] > 0.05).double().mean() > 0.3
    expected = torch.autograd.grad(out, list(leaves.values()), like(out, 2))
    for (name, a), b in zip(found.items(), expected, strict=True):
        assert (a - b).norm() <= 1e-10 * b.norm(), name
        assert b.norm() > 0, name


@pytest.mark.parametrize("model", CAMERAS)
def test_torchs_gradcheck_agrees_in_both_modes(model):
    inputs, images = case(model, model == "ortho", gaussians=3, width=7, height=5, degree=1)
    leaves = [v.requires_grad_() for v in inputs.values()]
    fn = lambda *tensors: images(render, dict(zip(inputs, tensors, strict=True)))
    assert torch.autograd.gradcheck(fn, leaves, check_forward_ad=True)


def test_an_empty_picture_has_the_backgrounds_tangent():
    inputs, images = case("pinhole")
    inputs["means"] = inputs["means"] + 100
    gradients = assert_transposed(images, inputs)
    assert gradients["T_camera_world"].abs().sum() == 0 == gradients["K"].abs().sum()


def test_drjits_forward_mode_transposes_its_reverse_mode():
    s = random_scene(torch.Generator().manual_seed(1), degree=1)
    kind, rng = ad.TensorXf64, np.random.default_rng(0)
    values = {k: v.detach().numpy() for k, v in s.inputs().items()}
    values |= {"T_camera_world": s.camera.T_camera_world.copy(), "K": s.camera.K}

    def draw(tensors):
        matrices = {k: tensors.pop(k) for k in ("T_camera_world", "K")}
        background = tensors.pop("background")
        view = s.camera.with_matrices(**matrices)
        image = native(Gaussians(**tensors), view, background=background)
        return image.color, image.alpha, image.depth

    leaves = {k: kind(v) for k, v in values.items()}
    dr.enable_grad(leaves)
    out = draw(dict(leaves))
    w = [rng.normal(size=o.shape) for o in out]
    dr.backward(sum(dr.sum(o * kind(d)) for o, d in zip(out, w, strict=True)))
    v = {k: rng.normal(size=x.shape) for k, x in values.items()}
    right = sum((dr.grad(leaves[k]).numpy() * v[k]).sum() for k in v)

    leaves = {k: kind(x) for k, x in values.items()}
    dr.enable_grad(leaves)
    for k, leaf in leaves.items():
        dr.set_grad(leaf, kind(v[k]))
    tangents = dr.forward_to(*draw(dict(leaves)))
    left = sum((t.numpy() * d).sum() for t, d in zip(tangents, w, strict=True))
    np.testing.assert_allclose(left, right, rtol=1e-12)
