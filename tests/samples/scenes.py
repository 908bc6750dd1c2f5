"""Scenes of random Gaussians, their pictures, and their ``.npz`` files."""

import numpy as np
import torch

from gva_mi.splat import render
from gva_mi.splat.scene import random_scene


def scene(seed=0, **kwargs):
    return random_scene(torch.Generator().manual_seed(seed), **kwargs)


def draw(s, **kwargs):
    return render(s.gaussians, s.camera, s.options, s.background, **kwargs)


def double(*values):
    return torch.tensor(values, dtype=torch.float64)


def save_scene(path, scene):
    """Write Gaussians and their camera, as ``Scene.load`` reads them."""
    arrays, c = {k: v.numpy() for k, v in scene.inputs().items()}, scene.camera
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    np.savez(path, **arrays, **camera)
    return path


def few_gaussians(path):
    """Write 8 Gaussians before a camera."""
    return save_scene(path, scene(gaussians=8, width=20, height=16))
