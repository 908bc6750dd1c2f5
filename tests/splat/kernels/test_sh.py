"""Spherical harmonics match the reference, and the adjoint is the derivative."""

import numpy as np
import pytest
import torch

from gva_mi.splat import reference
from gva_mi.splat.gaussians import MAX_DEGREE
from gva_mi.splat.kernels import sh


def directions(n: int) -> torch.Tensor:
    d = torch.randn(n, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return d / d.norm(dim=1, keepdim=True)


def basis(d: torch.Tensor) -> torch.Tensor:
    return torch.stack(sh.basis(MAX_DEGREE, *d.unbind(1)), dim=1)


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
    expected = torch.zeros_like(d) if d.grad is None else d.grad
    found = torch.stack(sh.basis_adjoint(degree, *d.detach().unbind(1), list(g.unbind(1))), dim=1)
    torch.testing.assert_close(found, expected, atol=1e-13, rtol=0)


def test_harmonics_are_orthonormal():
    """Their products, averaged over the sphere by Gauss's rule, are 1 / 4 pi where they agree."""
    z, weight = np.polynomial.legendre.leggauss(12)
    angle = np.arange(24) * (2 * np.pi / 24)
    r = np.sqrt(1 - z**2)[:, None]
    grid = [r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z[:, None], (12, 24))]
    directions = torch.tensor(np.stack(grid, axis=-1).reshape(-1, 3))
    Y = reference.harmonics(directions, 25).numpy()
    weights = np.repeat(weight / 2 / 24, 24) * 4 * np.pi
    np.testing.assert_allclose((Y * weights[:, None]).T @ Y, np.eye(25), atol=1e-12)
