"""The twin against what is known without it, and against the native door where torch has none."""

import numpy as np
import torch
from drjit.llvm import TensorXf64

from gva_mi.splat import drjit_op as native
from gva_mi.splat import reference
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import random_scene


def test_a_pixel_shows_what_is_nearer_than_its_limit():
    s = random_scene(torch.Generator().manual_seed(0), degree=1, width=20, height=14)
    limit = 2.2 + 1.4 * torch.rand(14, 20, generator=torch.Generator().manual_seed(1)).double()
    limit[:, 10:] = torch.inf
    image = reference.render(s.gaussians, s.camera, depth_limit=limit)
    whole = reference.render(s.gaussians, s.camera)
    assert torch.equal(image.color[:, 10:], whole.color[:, 10:])
    assert (image.alpha[:, :10] < whole.alpha[:, :10]).double().mean() > 0.5
    arrays = {k: TensorXf64(v.numpy()) for k, v in s.gaussians.arrays().items()}
    found = native.render(Gaussians(**arrays), s.camera, depth_limit=TensorXf64(limit.numpy()))
    for name in ("color", "alpha", "depth"):
        np.testing.assert_allclose(getattr(found, name), getattr(image, name), atol=1e-12)


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
