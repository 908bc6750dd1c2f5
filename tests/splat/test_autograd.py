"""torch.func and torch.autograd: first derivatives are exact, second ones raise."""

from dataclasses import replace

import pytest
import torch
from torch.autograd import forward_ad, functional, gradgradcheck
from torch.func import grad, hessian, jacfwd, jacrev, jvp, vjp, vmap

from gva_mi.splat import Camera, Gaussians, rasterization, render
from gva_mi.splat.scene import random_scene

SCENE = random_scene(torch.Generator().manual_seed(0), 8, 16, 12)
MEANS = SCENE.gaussians.means
POSE = torch.tensor(SCENE.camera.T_camera_world)
REFUSED = "cannot be differentiated again"


def like(tensor, seed=1):
    return torch.randn(tensor.shape, generator=torch.Generator().manual_seed(seed)).double()


def picture(means, pose=None):
    camera = SCENE.camera if pose is None else SCENE.camera.with_matrices(pose)
    return render(replace(SCENE.gaussians, means=means), camera).color


def called(means, packed):
    """gsplat's call: the picture and its meta."""
    g, camera = SCENE.gaussians, SCENE.camera
    K, size = torch.tensor(camera.K)[None], (camera.width, camera.height)
    body = (means, g.quats, g.scales, g.opacities, g.colors)
    found = rasterization(*body, POSE[None], K, *size, packed=packed)
    return found[0], found[2]


def mean(means, pose=None):
    return picture(means, pose).mean()


def by_autograd(function, x, weights=None):
    x = x.detach().clone().requires_grad_()
    return torch.autograd.grad(function(x), x, weights)[0]


def by_dual_numbers(function, x, v):
    with forward_ad.dual_level():
        return forward_ad.unpack_dual(function(forward_ad.make_dual(x, v))).tangent


def test_func_finds_what_autograd_finds():
    v, w = like(MEANS), like(picture(MEANS), 2)
    tangent = by_dual_numbers(picture, MEANS, v)
    for found, expected in (
        (grad(mean)(MEANS), by_autograd(mean, MEANS)),
        (vjp(picture, MEANS)[1](w)[0], by_autograd(picture, MEANS, w)),
        (jvp(picture, (MEANS,), (v,))[1], tangent),
        (functional.jvp(picture, MEANS, v)[1], tangent),  # it differentiates the adjoint
        (grad(lambda T: mean(MEANS, T))(POSE), by_autograd(lambda T: mean(MEANS, T), POSE)),
    ):
        assert expected.abs().sum() > 0
        torch.testing.assert_close(found, expected, atol=0, rtol=0)


def test_vmap_draws_one_picture_after_the_other():
    batch = torch.stack([MEANS, MEANS + 0.1, 0.9 * MEANS])
    assert torch.equal(vmap(picture)(batch), torch.stack([picture(x) for x in batch]))
    found = vmap(grad(mean))(batch)
    assert torch.equal(found, torch.stack([by_autograd(mean, x) for x in batch]))
    v = like(batch)
    found = vmap(lambda x, d: jvp(picture, (x,), (d,))[1])(batch, v)
    expected = [by_dual_numbers(picture, x, d) for x, d in zip(batch, v, strict=True)]
    assert torch.equal(found, torch.stack(expected))


@pytest.mark.parametrize("jacobian", [jacrev, jacfwd])
@pytest.mark.parametrize("entry", ["render", "packed"])
def test_jacobians_of_a_batch_are_those_of_its_pictures(entry, jacobian):
    """Also with as many pictures as channels: a batch of gradients is not one of pictures."""
    draw = picture if entry == "render" else lambda means: called(means, True)[0]
    channels = lambda means: draw(means).mean(dim=(-3, -2)).view(3)
    batch = torch.stack([MEANS, MEANS + 0.1, 0.9 * MEANS])
    found = vmap(jacobian(channels))(batch)
    one_by_one = [
        torch.stack([by_autograd(lambda x, k=k: channels(x)[k], means) for k in range(3)])
        for means in batch
    ]
    torch.testing.assert_close(found, torch.stack(one_by_one))


def test_adjoint_and_tangent_are_each_others_derivative():
    """By the argument in which each is linear: not a second derivative of the picture."""
    v = like(MEANS)
    total = lambda d: jvp(picture, (MEANS,), (d,))[1].sum()
    assert torch.equal(grad(total)(v), by_autograd(lambda x: picture(x).sum(), MEANS))

    x = MEANS.clone().requires_grad_()
    brightness = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    (by_x,) = torch.autograd.grad(brightness * mean(x), x, create_graph=True)
    (by_brightness,) = torch.autograd.grad(by_x.sum(), brightness)
    torch.testing.assert_close(by_brightness, by_autograd(mean, MEANS).sum())


SECOND = {
    "functional.hvp": lambda v: functional.hvp(mean, MEANS, v),
    "func.hessian": lambda v: hessian(mean)(MEANS),
    "grad of jvp": lambda v: grad(lambda x: jvp(mean, (x,), (v,))[1])(MEANS),
    "jvp of jvp": lambda v: jvp(lambda x: jvp(mean, (x,), (v,))[1], (MEANS,), (v,)),
    "of dual numbers": lambda v: by_autograd(lambda x: by_dual_numbers(mean, x, v), MEANS),
    "gradgradcheck": lambda v: gradgradcheck(picture, MEANS.clone().requires_grad_()),
    "rasterization": lambda v: functional.hvp(lambda x: called(x, False)[0].mean(), MEANS, v),
    "packed": lambda v: hessian(lambda x: called(x, True)[0].mean())(MEANS),
}


@pytest.mark.parametrize("name", SECOND)
def test_second_derivatives_are_refused(name):
    with pytest.raises(RuntimeError, match=REFUSED):
        SECOND[name](like(MEANS))


INPUTS = {"K": torch.tensor(SCENE.camera.K), "T": POSE, "background": SCENE.background}
INPUTS |= SCENE.gaussians.arrays()


@pytest.mark.parametrize("name", INPUTS)
def test_second_derivatives_are_refused_by_every_input(name):
    camera = SCENE.camera

    def loss(x):
        given = {k: v.detach() for k, v in INPUTS.items()} | {name: x}
        K, T, background = (given.pop(k) for k in ("K", "T", "background"))
        view = Camera.from_matrices(K, T, camera.width, camera.height, camera.model)
        image = render(Gaussians(**given), view, background=background)
        return image.color.square().mean() + image.alpha.mean() + image.depth.mean()

    x = INPUTS[name].detach()
    x = x.clone().requires_grad_()
    (by_x,) = torch.autograd.grad(loss(x), x, create_graph=True)
    with pytest.raises(RuntimeError, match=REFUSED):
        by_x.square().sum().backward()


def test_projected_means_have_second_derivatives():
    """They have a formula in torch, unlike the picture."""
    for packed in (False, True):
        moved = lambda x, packed=packed: called(x, packed)[1]["means2d"].square().sum()
        v, h = like(MEANS), 1e-6
        _, found = functional.hvp(moved, MEANS, v)
        ahead, behind = (by_autograd(moved, MEANS + sign * h * v) for sign in (1, -1))
        torch.testing.assert_close(found, (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-6)


def test_batches_of_torchs_older_vmap_raise():
    x, weights = MEANS.clone().requires_grad_(), like(picture(MEANS).expand(2, -1, -1, -1))
    with pytest.raises(RuntimeError, match="no gradients or tangents in batches"):
        torch.autograd.grad(picture(x), x, weights, is_grads_batched=True)
    for strategy in ("reverse-mode", "forward-mode"):
        with pytest.raises(RuntimeError, match="no gradients or tangents in batches"):
            functional.jacobian(mean, MEANS, vectorize=True, strategy=strategy)


def test_compiled_code_draws_between_its_graphs():
    loss = lambda x: (3 * picture(2 * x)).mean()
    compiled = torch.compile(loss, backend="eager")
    assert torch.equal(by_autograd(compiled, MEANS), by_autograd(loss, MEANS))
