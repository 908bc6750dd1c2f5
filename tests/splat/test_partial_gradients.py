"""Gradients by some of the inputs: what the others need is left out, and nothing else changes."""

import pytest
import torch

from gva_mi.splat import Camera, Gaussians, Screen, render
from gva_mi.splat import reference as twin
from gva_mi.splat.autograd import Call, Tensors
from gva_mi.splat.kernels.inputs import Wanted
from gva_mi.splat.scene import random_scene

SCENE = random_scene(torch.Generator().manual_seed(0), 40, 32, 24)
IMAGES = {"color": ("color",), "all": ("color", "alpha", "depth"), "depth": ("depth",)}
SOME = (["means"], ["means", "quats"], ["opacities"], ["pose"], ["background"])


def inputs(channels, dtype):
    """Everything that is differentiated, by name; harmonics where ``channels`` is None."""
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
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_gradient_by_some_inputs_is_that_by_all_to_the_bit(channels, dtype, images):
    given = inputs(channels, dtype)
    colors = "sh" if channels is None else "colors"
    whole = gradients(given, list(given), images)
    assert images == ("depth",) or all(grad.abs().max() > 0 for grad in whole.values())
    for names in (*SOME, [colors], [colors, "background"], [colors, "pose"]):
        for name, grad in gradients(given, names, images).items():
            assert torch.equal(grad, whole[name]), (names, name)


def test_what_is_asked_of_the_kernels():
    nothing = Tensors(*[False] * len(Tensors._fields))
    call = Call(SCENE.camera, SCENE.options, False, None)
    asked = lambda call, **by: call.wanted(nothing._replace(**by))
    colors, means = asked(call, colors=True), asked(call, means=True)
    assert colors == Wanted(geometry=False) and means == Wanted(colors=False)
    assert asked(call, K=True) == Wanted(colors=False, camera=True)
    assert asked(call, means=True, colors=True) == Wanted()
    call.screen = Screen()  # its gradient is kept, whoever wants another one
    assert asked(call, colors=True).geometry


@pytest.mark.parametrize("count", range(1, 11))
def test_a_list_may_end_anywhere_in_a_turn_of_the_loop(count):
    """The loops meet several Gaussians a turn and read ahead: lists of all lengths end well."""
    random = torch.Generator().manual_seed(count)
    uniform = lambda *shape: torch.rand(*shape, generator=random, dtype=torch.float64)
    arrays = {
        "means": 0.2 * (uniform(count, 3) - 0.5) + torch.tensor([0.0, 0.0, 3.0]).double(),
        "quats": uniform(count, 4) - 0.5,
        "scales": 0.1 + 0.2 * uniform(count, 3),
        "opacities": 0.1 + 0.3 * uniform(count),
        "colors": uniform(count, 3),
    }
    camera = Camera(20, 20, 4, 2, torch.eye(4).numpy(), 8, 4)  # one tile
    weights, found = uniform(4, 8, 3), []
    for draw in (render, twin.render):
        leaves = [x.clone().requires_grad_() for x in arrays.values()]
        image = draw(Gaussians(*leaves), camera)
        found.append((image.color, *torch.autograd.grad(image.color, leaves, weights)))
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-11)
