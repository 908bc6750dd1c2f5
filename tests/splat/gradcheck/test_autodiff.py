"""Dr.Jit's autodiff through the plain loop draws the twin's picture."""

import pytest
import torch
from drjit.llvm.ad import TensorXf64

from gva_mi.splat import reference
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.gradcheck import autodiff
from gva_mi.splat.scene import random_scene


@pytest.mark.parametrize("degree", [None, 2])
def test_the_picture_is_the_twins(degree):
    generator = torch.Generator().manual_seed(0)
    s = random_scene(generator, gaussians=20, width=13, height=10, degree=degree)
    quats = s.gaussians.quats.clone()
    quats[3] = 0
    s = s.with_inputs(s.inputs() | {"quats": quats})
    expected = reference.render(s.gaussians, s.camera, s.options, s.background)
    arrays = {k: TensorXf64(v.numpy()) for k, v in s.inputs().items()}
    background = arrays.pop("background")
    found = autodiff.render(Gaussians(**arrays), s.camera, s.options, background)
    for name in ("color", "alpha", "depth"):
        image = torch.tensor(getattr(found, name).numpy())
        torch.testing.assert_close(image, getattr(expected, name), atol=1e-13, rtol=0)
