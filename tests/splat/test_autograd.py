"""torch.func's transforms and torch.autograd's: derivatives are exact, second ones are refused."""

from dataclasses import replace

import pytest
import torch
from torch.autograd import forward_ad, functional
from torch.func import grad, hessian, jacfwd, jacrev, jvp, vjp, vmap

from gva_mi.splat import render
from gva_mi.splat.gradcheck import random_scene

SCENE = random_scene(torch.Generator().manual_seed(0), 8, 16, 12)
MEANS = SCENE.gaussians.means
POSE = torch.tensor(SCENE.camera.T_camera_world)
REFUSED = "cannot be differentiated again"


def like(tensor, seed=1):
    return torch.randn(tensor.shape, generator=torch.Generator().manual_seed(seed)).double()


def picture(means, pose=None):
    camera = SCENE.camera if pose is None else SCENE.camera.with_matrices(pose)
    return render(replace(SCENE.gaussians, means=means), camera).color


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


def test_jacobians_are_the_same_in_both_directions():
    channels = lambda means: picture(means).mean(dim=(0, 1))
    rows = [by_autograd(lambda x, k=k: channels(x)[k], MEANS) for k in range(3)]
    for jacobian in (jacfwd, jacrev):
        torch.testing.assert_close(jacobian(channels)(MEANS), torch.stack(rows))


def test_vmap_draws_one_after_the_other():
    batch = torch.stack([MEANS, MEANS + 0.1, 0.9 * MEANS])
    assert torch.equal(vmap(picture)(batch), torch.stack([picture(x) for x in batch]))
    found = vmap(grad(mean))(batch)
    assert torch.equal(found, torch.stack([by_autograd(mean, x) for x in batch]))
    v = like(batch)
    found = vmap(lambda x, d: jvp(picture, (x,), (d,))[1])(batch, v)
    expected = [by_dual_numbers(picture, x, d) for x, d in zip(batch, v, strict=True)]
    assert torch.equal(found, torch.stack(expected))


def test_adjoint_and_tangent_are_each_others_derivative():
    """By what each is linear in, which is no second derivative of the picture."""
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
    "functional.vhp": lambda v: functional.vhp(mean, MEANS, v),
    "functional.hessian": lambda v: functional.hessian(mean, MEANS),
    "func.hessian": lambda v: hessian(mean)(MEANS),
    "jvp of grad": lambda v: jvp(grad(mean), (MEANS,), (v,)),
    "grad of jvp": lambda v: grad(lambda x: jvp(mean, (x,), (v,))[1])(MEANS),
    "grad of grad": lambda v: grad(lambda x: grad(mean)(x).sum())(MEANS),
    "by the camera": lambda v: grad(lambda T: grad(mean)(MEANS, T).sum())(POSE),
}


@pytest.mark.parametrize("name", SECOND)
def test_second_derivatives_are_refused(name):
    with pytest.raises(RuntimeError, match=REFUSED):
        SECOND[name](like(MEANS))


def test_a_penalty_on_a_gradient_is_refused():
    """Of a loss whose gradient by the picture is a constant, and beside other losses."""
    x = MEANS.clone().requires_grad_()
    (by_x,) = torch.autograd.grad(mean(x), x, create_graph=True)
    with pytest.raises(RuntimeError, match=REFUSED):
        (by_x.norm() + x.sum()).backward()


def test_compiled_code_draws_between_its_graphs():
    loss = lambda x: (3 * picture(2 * x)).mean()
    compiled = torch.compile(loss, backend="eager")
    assert torch.equal(by_autograd(compiled, MEANS), by_autograd(loss, MEANS))
