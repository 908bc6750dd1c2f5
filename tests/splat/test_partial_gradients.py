"""Gradients of some inputs have the same bits as if all were requested."""

import pytest
import torch

from gva_mi.splat import Camera, Gaussians, reference, render
from gva_mi.splat.scene import random_scene

SCENE = random_scene(torch.Generator().manual_seed(0), 40, 32, 24)
IMAGES = {"all": ("color", "alpha", "depth"), "depth": ("depth",)}
SOME = (["means"], ["means", "quats"], ["opacities"], ["pose"], ["background"])


def inputs(channels, dtype):
    """Make all inputs by name; harmonics if ``channels`` is None."""
    scene, random = SCENE.to(dtype), torch.Generator().manual_seed(1)
    given = dict(scene.gaussians.arrays())
    if channels is None:
        given["sh"] = 0.3 * torch.randn(40, 9, 3, generator=random).to(dtype)
        del given["colors"]
    else:
        given["colors"] = torch.rand(40, channels, generator=random).to(dtype)
    behind = torch.rand(channels or 3, generator=random).to(dtype)
    pose = torch.tensor(scene.camera.T_camera_world, dtype=dtype)
    return given | {"background": behind, "pose": pose}


def gradients(given, names, images):
    leaves = {k: v.detach().clone().requires_grad_(k in names) for k, v in given.items()}
    camera = SCENE.camera.with_matrices(leaves["pose"])
    rest = {k: v for k, v in leaves.items() if k not in ("background", "pose")}
    image = render(Gaussians(**rest), camera, background=leaves["background"])
    random = torch.Generator().manual_seed(2)
    seen = [getattr(image, name) for name in images]
    weights = [torch.randn(x.shape, generator=random).to(x.dtype) for x in seen]
    found = torch.autograd.grad(seen, [leaves[name] for name in names], weights)
    return dict(zip(names, found, strict=True))


@pytest.mark.parametrize("images", IMAGES.values(), ids=IMAGES)
@pytest.mark.parametrize("channels", [None, 3, 11])
def test_gradients_of_some_inputs_have_the_bits_of_all_gradients(channels, images):
    given = inputs(channels, torch.float32)
    colors = "sh" if channels is None else "colors"
    whole = gradients(given, list(given), images)
    assert images == ("depth",) or all(grad.abs().max() > 0 for grad in whole.values())
    for names in (*SOME, [colors], [colors, "background"], [colors, "pose"]):
        for name, grad in gradients(given, names, images).items():
            assert torch.equal(grad, whole[name]), (names, name)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 9])
def test_a_list_may_end_anywhere_in_a_turn_of_the_loop(count):
    """The loops process several Gaussians per turn and read ahead; any length must work."""
    random = torch.Generator().manual_seed(count)
    uniform = lambda *shape: torch.rand(*shape, generator=random, dtype=torch.float64)
    arrays = {"means": 0.2 * (uniform(count, 3) - 0.5) + torch.tensor([0.0, 0.0, 3.0]).double(),
        "quats": uniform(count, 4) - 0.5, "scales": 0.1 + 0.2 * uniform(count, 3),
        "opacities": 0.1 + 0.3 * uniform(count), "colors": uniform(count, 3)}  # fmt: skip
    camera = Camera(20, 20, 4, 2, torch.eye(4).numpy(), 8, 4)  # one tile
    weights, found = uniform(4, 8, 3), []
    for draw in (render, reference.render):
        leaves = [x.clone().requires_grad_() for x in arrays.values()]
        image = draw(Gaussians(*leaves), camera)
        found.append((image.color, *torch.autograd.grad(image.color, leaves, weights)))
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-11)
