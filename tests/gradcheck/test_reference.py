"""Dr.Jit's autodiff through a plain loop confirms the reference: image and every gradient."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import drjit as dr
import pytest
import torch
from drjit.llvm.ad import TensorXf64

from gva_mi.splat import reference
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import random_scene

spec = importlib.util.spec_from_file_location(
    "drjit_autodiff", Path(__file__).with_name("drjit_autodiff.py")
)
drjit_autodiff = importlib.util.module_from_spec(spec)
spec.loader.exec_module(drjit_autodiff)


@pytest.mark.parametrize(
    ("degree", "model", "antialiased"),
    [(None, "pinhole", False), (2, "pinhole", True), (1, "ortho", False), (1, "fisheye", True)],
)
def test_image_and_gradients_are_the_references(degree, model, antialiased):
    generator = torch.Generator().manual_seed(0)
    s = random_scene(generator, gaussians=20, width=13, height=10, degree=degree)
    quats = s.gaussians.quats.clone()
    quats[3] = 0
    camera = replace(s.camera, model=model)
    camera = replace(camera, fx=6.0, fy=7.0) if model == "ortho" else camera
    options = replace(s.options, antialiased=antialiased)
    s = replace(s, camera=camera, options=options).with_inputs(s.inputs() | {"quats": quats})
    s = s.with_camera_inputs().to(torch.float64)
    weights = {
        name: torch.randn(size, generator=generator).double()
        for name, size in (("color", (10, 13, 3)), ("alpha", (10, 13)), ("depth", (10, 13)))
    }
    expected = reference.render(s.gaussians, s.camera, s.options, s.background)
    total = sum((getattr(expected, name) * w).sum() for name, w in weights.items())
    truth = torch.autograd.grad(total, list(s.inputs().values()))

    arrays = {k: TensorXf64(v.detach().contiguous().numpy()) for k, v in s.inputs().items()}
    dr.enable_grad(list(arrays.values()))
    gaussians = Gaussians(**{k: arrays[k] for k in s.gaussians.arrays()})
    view = s.camera.with_matrices(arrays["T_camera_world"], arrays["K"])
    found = drjit_autodiff.render(gaussians, view, s.options, arrays["background"])
    for name in weights:
        image = torch.tensor(getattr(found, name).numpy())
        torch.testing.assert_close(image, getattr(expected, name).detach(), atol=1e-13, rtol=0)
    dr.backward(
        sum(dr.sum(getattr(found, k).array * TensorXf64(w.numpy()).array)
            for k, w in weights.items())
    )  # fmt: skip
    for (name, array), g in zip(arrays.items(), truth, strict=True):
        off = torch.tensor(dr.grad(array).numpy()) - g
        assert off.norm() <= 1e-10 * g.norm(), name
