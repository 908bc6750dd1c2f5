"""Spherical harmonics are an orthonormal basis, and the adjoint is the derivative."""

import numpy as np
import pytest
import torch

from gva_mi.splat import reference
from gva_mi.splat.gaussians import MAX_DEGREE, degree_of
from gva_mi.splat.kernels import sh


def directions(n: int) -> torch.Tensor:
    d = torch.randn(n, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return d / d.norm(dim=1, keepdim=True)


def basis(d: torch.Tensor) -> torch.Tensor:
    return torch.stack(sh.basis(MAX_DEGREE, *d.unbind(1)), dim=1)


def test_orthonormal_on_the_sphere():
    # Gauss-Legendre in z, equidistant in the angle: exact for polynomials of this degree
    z, weights = np.polynomial.legendre.leggauss(12)
    angle = np.arange(24) * 2 * np.pi / 24
    ring = np.sqrt(1 - z**2)
    points = [ring[:, None] * np.cos(angle), ring[:, None] * np.sin(angle), z[:, None] + 0 * angle]
    b = basis(torch.tensor(np.stack(points, axis=-1).reshape(-1, 3)))
    w = torch.tensor(np.repeat(weights * 2 * np.pi / 24, 24))
    torch.testing.assert_close(b.T @ (w[:, None] * b), torch.eye(25, dtype=torch.float64))


def test_polynomials_agree_with_the_recurrences():
    d = directions(40)
    torch.testing.assert_close(basis(d), reference.harmonics(d, 25), atol=1e-14, rtol=0)


@pytest.mark.parametrize("degree", range(MAX_DEGREE + 1))
def test_adjoint_is_the_derivative(degree):
    d = directions(20).requires_grad_()
    g = torch.randn(20, (degree + 1) ** 2, generator=torch.Generator().manual_seed(1))
    g = g.to(torch.float64)
    total = (torch.stack(sh.basis(degree, *d.unbind(1)), dim=1) * g).sum()
    total.backward() if degree else total
    truth = torch.zeros_like(d) if d.grad is None else d.grad
    found = torch.stack(sh.basis_adjoint(degree, *d.detach().unbind(1), list(g.unbind(1))), dim=1)
    torch.testing.assert_close(found, truth, atol=1e-13, rtol=0)


def test_degree_of_a_count():
    assert [degree_of(k) for k in (1, 4, 9, 16, 25)] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match="1, 4, 9, 16 or 25 coefficients, got 5"):
        degree_of(5)
