"""Products with matrices over frames are those of torch."""

import os

import pytest
import torch

from gva_mi.prior.process import FrameMatrices

FIXED = os.environ.get("MKL_CBWR") == "COMPATIBLE"


def matrices_and_vectors(n, d, seed=0, dtype=torch.float32):
    generator = torch.Generator().manual_seed(seed)
    M = torch.randn(4, n, n, generator=generator, dtype=dtype)
    x = torch.randn(n, 4, d, generator=generator, dtype=dtype)
    return M, x.transpose(0, 1).requires_grad_()


@pytest.mark.parametrize("d", [1, 3])
@pytest.mark.parametrize("n", [1, 2, 11, 12, 40, 97, 150, 240])
@pytest.mark.parametrize("by_columns", [False, True])
def test_the_product_and_its_gradient_are_those_of_torch(n, d, by_columns):
    M, x = matrices_and_vectors(n, d)
    M = M.mT if by_columns else M
    expected, found = M @ x, FrameMatrices.of(M) @ x
    weights = torch.randn(found.shape, generator=torch.Generator().manual_seed(1))
    (by_torch,), (grad,) = (torch.autograd.grad(y, x, weights) for y in (expected, found))
    for a, b in ((found, expected), (grad, by_torch)):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-5)
        assert a.is_contiguous()
        assert not FIXED or torch.equal(a, b)


def test_the_gradient_is_the_adjoint():
    M, x = matrices_and_vectors(5, 3, dtype=torch.float64)
    assert torch.autograd.gradcheck(FrameMatrices.of(M).__matmul__, x.detach().requires_grad_())


def test_some_rows_are_those_of_the_whole_product():
    M, x = matrices_and_vectors(6, 3)
    held = FrameMatrices.of(M)
    torch.testing.assert_close(held.product(x, [4, 1]), (M @ x)[:, [4, 1]])
    assert torch.equal(held.rows([4, 1]), M[:, [4, 1]])
    assert held.rows(list(range(6))) is held.M  # no copy
