"""The residual: zero at first and at rest, blind to the root and to joints that are far away, one
function for any set of Gaussians."""

import pytest
import torch

from gva_mi.avatar.residual import PoseResidual, ResidualOptions


@pytest.fixture
def points():
    return torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) - 0.5


@pytest.fixture
def weights():
    """Each of the points follows one joint of the body, most of them a knee or an elbow."""
    joints = torch.tensor([4, 18, 5, 19, 1, 16, 0, 12, 20, 40]).repeat(5)
    return torch.nn.functional.one_hot(joints, 55).float()


@pytest.fixture
def rotations():
    return 0.4 * torch.randn(55, 3, generator=torch.Generator().manual_seed(1))


def network(trained=True, **options):
    generator = torch.Generator().manual_seed(2)
    mlp = PoseResidual(ResidualOptions(**options), torch.zeros(3), 0.5, generator)
    if trained:
        torch.nn.init.normal_(mlp.offset.weight, generator=generator)
    return mlp


def test_is_zero_where_nothing_bends(points, weights, rotations):
    mlp = network()
    assert (mlp(points, weights, torch.zeros(55, 3)) == 0).all()
    elbow = torch.zeros(55, 3)
    elbow[18] = rotations[18]
    moved = mlp(points, weights, elbow).abs().amax(1) > 0
    follows = weights.argmax(1)
    assert torch.equal(moved, (follows == 18) | (follows == 16))  # forearm and upper arm


def test_is_zero_at_first_and_blind_to_the_root(points, weights, rotations):
    assert (network(trained=False)(points, weights, rotations) == 0).all()
    turned, mlp = rotations.clone(), network()
    turned[0] += 1
    assert torch.equal(mlp(points, weights, rotations), mlp(points, weights, turned))
