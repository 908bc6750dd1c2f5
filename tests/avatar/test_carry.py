"""One kernel each way gives what blend, stretch and light give one after the other."""

import pytest
import torch

from gva_mi.avatar.carry import carry
from gva_mi.avatar.light import lit
from gva_mi.avatar.maps import PIECE, FollowedJoints
from gva_mi.avatar.stretch import carry_stretched

JOINTS = 6


def scene(dtype, n=2 * PIECE + 5, slopes=3):
    g = torch.Generator().manual_seed(2)
    random = lambda *shape: torch.randn(*shape, generator=g, dtype=torch.float64)
    follows = torch.rand(n, JOINTS, generator=g) < 0.6
    joints = FollowedJoints.of(
        (random(n, JOINTS) * follows).to(dtype), (random(n, 3, JOINTS) * follows[:, None]).to(dtype)
    )
    scales = random(n, 3).exp() / 10
    leaves = random(n, 3), random(n, 4), scales, random(n, 1 + slopes, 3), random(3)
    return joints, [random(JOINTS, 4, 4), *(x.to(dtype) for x in leaves)]


def one_by_one(joints, T, means, quats, scales, sh, light):
    A, E = joints(T, means)
    return *carry_stretched(A, E, means, quats, scales), lit(sh, A, light)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("slopes", [0, 3])
def test_it_is_the_three_in_a_row(dtype, slopes):
    joints, inputs = scene(dtype, slopes=slopes)
    inputs = [x.requires_grad_() for x in inputs]
    outs = carry(joints, *inputs), one_by_one(joints, *inputs)
    for one, other in zip(*outs, strict=True):
        assert one.shape == other.shape
        torch.testing.assert_close(one, other)
    g = torch.Generator().manual_seed(3)
    grads = [torch.randn(x.shape, generator=g, dtype=torch.float64).to(x) for x in outs[0]]
    found = [torch.autograd.grad(out, inputs, grads, allow_unused=True) for out in outs]
    for one, other in zip(*found, strict=True):
        expected = torch.zeros_like(one) if other is None else other  # no slopes, no light
        scale = float(expected.abs().max())
        torch.testing.assert_close(one, expected, atol=2e-6 * scale, rtol=1e-4)


def test_gradients_and_tangents_by_differences():
    joints, inputs = scene(torch.float64, n=5)
    inputs = [x.requires_grad_() for x in inputs]
    function = lambda *inputs: carry(joints, *inputs)
    assert torch.autograd.gradcheck(function, inputs, atol=1e-7, check_forward_ad=True)


def test_the_same_bits_again_and_for_other_numbers_of_gaussians_in_between():
    runs = []
    for n in (300, 40, 300):
        joints, inputs = scene(torch.float32, n=n)
        inputs = [x.requires_grad_() for x in inputs]
        outs = carry(joints, *inputs)
        total = sum(x.square().sum() for x in outs)
        runs.append([*outs, *torch.autograd.grad(total, inputs)])
    assert all(torch.equal(a, b) for a, b in zip(runs[0], runs[2], strict=True))
    assert len(runs[1][0]) == 40 and not runs[1][0].isnan().any()


def test_nobody_is_carried_nowhere():
    joints, inputs = scene(torch.float32, n=0)
    moved, covars, colors = carry(joints, *inputs)
    assert moved.shape == (0, 3) and covars.shape == (0, 6) and colors.shape == (0, 1, 3)
