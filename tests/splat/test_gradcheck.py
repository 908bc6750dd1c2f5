"""Four answers agree: adjoint in both precisions, the twin, and central differences."""

from dataclasses import replace

import pytest
import torch

from gva_mi.splat.gaussians import Image
from gva_mi.splat.gradcheck import gradcheck, random_scene
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.torch_op import render

SCENES = {
    "colors": {},
    "sh 0": {"degree": 0},
    "sh 1": {"degree": 1},
    "sh 2": {"degree": 2},
    "sh 3": {"degree": 3},
    "sh 4": {"degree": 4},
    "odd size": {"width": 23, "height": 17},
    "five channels": {"channels": 5},
}


@pytest.mark.parametrize("name", SCENES)
def test_every_gradient_is_right(name):
    report = gradcheck(render, random_scene(torch.Generator().manual_seed(1), **SCENES[name]))
    assert report.passed, report.table()
    assert report.band < 0.02 * report.pixels


def test_other_cut_offs():
    options = SplatOptions(alpha_min=0.02, alpha_max=0.9, transmittance_min=0.05, blur=1.0)
    scene = replace(random_scene(torch.Generator().manual_seed(2)), options=options)
    report = gradcheck(render, scene)
    assert report.passed, report.table()


def test_names_every_input_and_image():
    report = gradcheck(render, random_scene(torch.Generator().manual_seed(1), gaussians=5))
    names = {row.name for row in report.rows if row.method == "adjoint f32"}
    inputs = {"means", "quats", "scales", "opacities", "colors", "background"}
    assert names == inputs | {"color", "alpha", "depth"}
    assert {row.name for row in report.rows if row.method == "differences"} == inputs


def test_a_wrong_adjoint_is_found():
    def wrong(gaussians, camera, options, background):
        gaussians = replace(gaussians, scales=_Doubled.apply(gaussians.scales))
        return Image(**vars(render(gaussians, camera, options, background)))

    report = gradcheck(wrong, random_scene(torch.Generator().manual_seed(1)))
    assert not report.passed
    assert {row.name for row in report.rows if not row.passed} == {"scales"}
    assert "fails" in report.table()


class _Doubled(torch.autograd.Function):
    """The identity with twice its gradient."""

    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, g):
        return 2 * g


def test_torch_agrees():
    scene = random_scene(torch.Generator().manual_seed(4), gaussians=4, width=9, height=6)
    inputs = {k: v.requires_grad_() for k, v in scene.inputs().items()}

    def images(*tensors):
        s = scene.with_inputs(dict(zip(inputs, tensors, strict=True)))
        image = render(s.gaussians, s.camera, s.options, s.background)
        return image.color, image.alpha, image.depth

    assert torch.autograd.gradcheck(images, tuple(inputs.values()))
