"""``render`` on Dr.Jit tensors gives the same bits as on torch's, through Dr.Jit's autodiff."""

import subprocess
import sys

import drjit as dr
import numpy as np
import pytest
import torch
from drjit.llvm import ad

from gva_mi.splat import torch_render
from gva_mi.splat.drjit_render import render
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import random_scene


@pytest.mark.parametrize(
    "dtype, kind", [(torch.float32, ad.TensorXf), (torch.float64, ad.TensorXf64)]
)
@pytest.mark.parametrize("degree", [None, 2])
def test_same_bits_as_torch(dtype, kind, degree):
    generator = torch.Generator().manual_seed(3)
    scene = random_scene(generator, width=21, height=18, degree=degree).to(dtype)
    weights = torch.randn(18, 21, 3, generator=generator).to(dtype)
    image = torch_render.render(scene.gaussians, scene.camera, background=scene.background)
    loss = (image.color * weights).sum() + image.alpha.square().sum() + image.depth.sum()
    loss.backward()

    inputs = {name: kind(t.detach().numpy()) for name, t in scene.inputs().items()}
    dr.enable_grad(inputs)
    background = inputs.pop("background")
    found = render(Gaussians(**inputs), scene.camera, background=background)
    for name in ("color", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(found, name), getattr(image, name).detach().numpy())
    loss = dr.sum(found.color * kind(weights.numpy()))
    dr.backward(loss + dr.sum(dr.square(found.alpha)) + dr.sum(found.depth))
    for name, array in (inputs | {"background": background}).items():
        np.testing.assert_array_equal(dr.grad(array), scene.inputs()[name].grad.numpy(), name)


def test_drjits_forward_mode_transposes_its_reverse_mode():
    s = random_scene(torch.Generator().manual_seed(1), degree=1)
    kind, rng = ad.TensorXf64, np.random.default_rng(0)
    values = {k: v.detach().numpy() for k, v in s.inputs().items()}
    values |= {"T_camera_world": s.camera.T_camera_world.copy(), "K": s.camera.K}

    def draw(tensors):
        matrices = {k: tensors.pop(k) for k in ("T_camera_world", "K")}
        background = tensors.pop("background")
        view = s.camera.with_matrices(**matrices)
        image = render(Gaussians(**tensors), view, background=background)
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


FREEZE = """
import numpy as np
from gva_mi.splat import Camera, Gaussians
from gva_mi.splat.drjit_render import render
import drjit as dr
from drjit.llvm import TensorXf
ones = lambda *shape: TensorXf(np.ones(shape, np.float32))
camera = Camera(8.0, 8.0, 4.0, 4.0, np.eye(4), 8, 8)
frozen = dr.freeze(lambda m: render(
    Gaussians(m, ones(2, 4), ones(2, 3), ones(2), colors=ones(2, 3)), camera).color)
try:
    frozen(ones(2, 3))
except RuntimeError as error:
    print(error.__cause__)
"""


def test_it_refuses_to_be_frozen():
    # in a process of its own: Dr.Jit may abort when it clears an unfinished recording away
    found = subprocess.run([sys.executable, "-c", FREEZE], capture_output=True, text=True)
    assert "do not call it in dr.freeze" in found.stdout
