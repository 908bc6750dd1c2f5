"""Rotations: values and derivatives, against roma."""

import pytest
import roma
import torch

from gva_mi.body.so3 import compose, nearest, to_matrix, to_rotvec, turns_between


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


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 1.0, 3.14159])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_matrices_and_back(size, dtype):
    x = vectors(size, size, size, seed=2).to(dtype).requires_grad_()
    R, expected = to_matrix(x), roma.rotvec_to_rotmat(x)
    assert torch.equal(R, expected)
    weights = torch.randn(R.shape, dtype=dtype, generator=torch.Generator().manual_seed(3))
    ours, theirs = (torch.autograd.grad((y * weights).sum(), x)[0] for y in (R, expected))
    torch.testing.assert_close(ours, theirs)
    torch.testing.assert_close(to_rotvec(R), roma.rotmat_to_rotvec(R), rtol=1e-6, atol=0)


def test_the_nearest_rotation_is_no_reflection():
    M = torch.randn(50, 3, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    assert torch.equal(nearest(M), roma.special_procrustes(M, method="svd"))


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 0.28, 1.0, 3.14159])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_turns_between_rotations(size, dtype):
    """In the bits of roma, under which the refinement was tuned and measured."""
    a = vectors(0.3, 1.2, 2.9, 1e-3).to(dtype).requires_grad_()
    b = (a.detach() + vectors(size, size, size, size, seed=1)).to(dtype).requires_grad_()
    found, expected = turns_between(a, b), roma.rotvec_composition([-a, b])
    assert torch.equal(found, expected)
    weights = torch.randn(found.shape, dtype=dtype, generator=torch.Generator().manual_seed(3))
    ours, theirs = (torch.autograd.grad((y * weights).sum(), (a, b)) for y in (found, expected))
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.02, 1.0, 2.5])
def test_derivatives_against_differences(size):
    a = vectors(0.3, 1.2, 0.6).requires_grad_()
    b = vectors(size, size, size, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(compose, (a, b), atol=1e-7, check_forward_ad=True)
