"""Scenes of random Gaussians, their pictures, and their ``.npz`` files."""

import torch

from gva_mi.splat import Gaussians, render
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.scene import random_scene


def scene(seed=0, **kwargs):
    return random_scene(torch.Generator().manual_seed(seed), **kwargs)


def draw(s, **kwargs):
    return render(s.gaussians, s.camera, s.options, s.background, **kwargs)


def double(*values):
    return torch.tensor(values, dtype=torch.float64)


def some_gaussians(coefficients=4, count=20):
    """Make random Gaussians with harmonics, as files hold them."""
    generator = torch.Generator().manual_seed(0)
    draw = lambda *size: torch.randn(count, *size, generator=generator)
    return Gaussians(
        draw(3), draw(4), draw(3).exp(), torch.sigmoid(draw()), sh=draw(coefficients, 3)
    )


def in_drjit(gaussians, kind):
    """Convert Gaussians of torch to Dr.Jit's tensors of a kind."""
    arrays = {k: kind(v.detach().numpy()) for k, v in gaussians.arrays().items()}
    return Gaussians(**{"quats": None, "scales": None} | arrays)


def few_gaussians(path):
    """Write 8 Gaussians to a .ply."""
    save_ply(path, half_turned(scene(gaussians=8, width=20, height=16).gaussians))
    return path
