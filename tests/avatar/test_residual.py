"""The residual: zero at first, blind to the root, one function for any set of Gaussians."""

import pytest
import torch

from gva_mi.avatar.residual import OUTPUT_UNIT, PoseResidual, ResidualOptions


@pytest.fixture
def points():
    return torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) - 0.5


@pytest.fixture
def rotations():
    return 0.4 * torch.randn(55, 3, generator=torch.Generator().manual_seed(1))


def network(trained=True, **options):
    generator = torch.Generator().manual_seed(2)
    mlp = PoseResidual(ResidualOptions(**options), torch.zeros(3), 0.5, generator)
    if trained:
        torch.nn.init.normal_(mlp.offset.weight, generator=generator)
    return mlp


def test_starts_at_exactly_zero(points, rotations):
    assert (network(trained=False)(points, rotations) == 0).all()


def test_root_does_not_enter(points, rotations):
    turned = rotations.clone()
    turned[0] += 1
    mlp = network()
    assert torch.equal(mlp(points, rotations), mlp(points, turned))


def test_pose_enters(points, rotations):
    bent = rotations.clone()
    bent[4] += 1
    mlp = network()
    assert (mlp(points, rotations) - mlp(points, bent)).abs().max() > 0.1 * OUTPUT_UNIT


def test_a_subset_moves_as_the_whole(points, rotations):
    mlp = network()
    assert torch.allclose(mlp(points[::3], rotations), mlp(points, rotations)[::3], atol=1e-7)


def test_no_pose_is_out_of_bounds(points, rotations):
    mlp = network()
    usual = mlp(points, rotations).abs().max()
    for seed in range(10):
        wild = 3 * torch.randn(55, 3, generator=torch.Generator().manual_seed(seed))
        assert mlp(points, wild).abs().max() < 5 * usual


def test_every_parameter_receives_a_gradient_after_one_step(points, rotations):
    mlp = network(trained=False)
    optimizer = torch.optim.Adam(mlp.parameters(), 1e-3)
    target = torch.randn(50, 3, generator=torch.Generator().manual_seed(3))
    for _ in range(2):  # at the first step the zero layer shields the others
        optimizer.zero_grad()
        ((mlp(points, rotations) - target) ** 2).sum().backward()
        optimizer.step()
    for name, parameter in mlp.named_parameters():
        assert parameter.grad.abs().max() > 0, name


def test_pose_gradient_in_double_precision(points):
    mlp = network(width=8, frequencies=2).double()
    rotations = 0.3 * torch.ones(55, 3, dtype=torch.float64)
    rotations += 0.1 * torch.arange(165).view(55, 3).sin()
    rotations.requires_grad_()
    assert torch.autograd.gradcheck(lambda r: mlp(points[:2].double(), r).sum(), rotations)


def test_learns_a_crease_that_comes_with_a_bent_joint():
    generator = torch.Generator().manual_seed(4)
    mlp, points = network(trained=False), torch.rand(200, 3, generator=generator) - 0.5
    optimizer = torch.optim.Adam(mlp.parameters(), 1e-2)
    depth = 0.01 * torch.exp(-points.square().sum(1, keepdim=True) / 0.05)
    rotations = torch.zeros(2, 55, 3)
    rotations[1, 5, 0] = 0.8
    for step in range(80):
        optimizer.zero_grad()
        bent = step % 2
        loss = (mlp(points, rotations[bent]) - bent * depth).square().mean()
        loss.backward()
        optimizer.step()
    error = mlp(points, rotations[1]) - depth
    assert error.square().mean() < 0.05 * depth.square().mean()


def test_options_are_checked():
    with pytest.raises(ValueError, match="must be from 1 to"):
        ResidualOptions(width=0)
