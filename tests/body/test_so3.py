"""Composition of rotations: values and derivatives."""

import pytest
import roma
import torch

from gva_mi.body.so3 import compose


def vectors(*sizes, seed=0):
    g = torch.Generator().manual_seed(seed)
    directions = torch.nn.functional.normalize(
        torch.randn(len(sizes), 3, generator=g, dtype=torch.float64), dim=1
    )
    return directions * torch.tensor(sizes, dtype=torch.float64)[:, None]


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 1.0, 3.0])
def test_it_is_the_product_of_both_rotations(size):
    a, b = vectors(0.3, 1.2, 2.9), vectors(size, size, size, seed=1)
    R = roma.rotvec_to_rotmat(a) @ roma.rotvec_to_rotmat(b)
    torch.testing.assert_close(roma.rotvec_to_rotmat(compose(a, b)), R)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 1.0, 2.5])
def test_derivatives_against_differences(size):
    a = vectors(0.3, 1.2, 0.6).requires_grad_()
    b = vectors(size, size, size, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(compose, (a, b), atol=1e-7, check_forward_ad=True)
