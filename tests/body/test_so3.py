"""One rotation after another: values and derivatives."""

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
def test_it_is_the_product_of_both(size):
    a, b = vectors(0.3, 1.2, 2.9), vectors(size, size, size, seed=1)
    R = roma.rotvec_to_rotmat(a) @ roma.rotvec_to_rotmat(b)
    torch.testing.assert_close(roma.rotvec_to_rotmat(compose(a, b)), R)


@pytest.mark.parametrize("size", [1e-9, 1e-4, 0.02, 1.0, 2.5])
def test_derivatives_by_differences(size):
    a = vectors(0.3, 1.2, 0.6).requires_grad_()
    b = vectors(size, size, size, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(compose, (a, b), atol=1e-7, check_forward_ad=True)


def test_gradients_are_those_of_the_graph():
    a, b = vectors(0.4, 0.0, 2.0, 1e-5), vectors(0.05, 0.1, 0.3, 1e-3, seed=2)
    found = []
    for function in (compose, lambda a, b: roma.rotvec_composition([a, b])):
        leaves = [x.clone().requires_grad_() for x in (a, b)]
        weights = torch.arange(12, dtype=torch.float64).view(4, 3)
        found.append(torch.autograd.grad((function(*leaves) * weights).sum(), leaves))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, atol=1e-9, rtol=1e-9)


def test_a_correction_of_nothing_has_a_gradient():
    a, b = vectors(0.3, 1.0), torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    (grad,) = torch.autograd.grad(compose(a, b).sum(), b)
    assert torch.isfinite(grad).all() and (grad.norm(dim=1) > 0.1).all()


def test_single_precision_keeps_its_digits():
    a, b = vectors(0.3, 1.2, 2.0), vectors(1e-3, 1e-4, 0.1, seed=3)
    grads = []
    for dtype in (torch.float32, torch.float64):
        leaf = b.to(dtype).requires_grad_()
        grads.append(torch.autograd.grad(compose(a.to(dtype), leaf).sum(), leaf)[0].double())
    torch.testing.assert_close(grads[0], grads[1], atol=2e-6, rtol=2e-6)
