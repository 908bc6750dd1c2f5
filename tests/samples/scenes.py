"""Scenes of Gaussians in ``.npz`` files."""

import numpy as np
import torch

from gva_mi.splat.scene import random_scene


def save_scene(path, scene):
    """Write Gaussians and their camera, as ``Scene.load`` reads them."""
    arrays, c = {k: v.numpy() for k, v in scene.inputs().items()}, scene.camera
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    np.savez(path, **arrays, **camera)
    return path


def few_gaussians(path):
    """Write 8 Gaussians before a camera."""
    generator = torch.Generator().manual_seed(0)
    return save_scene(path, random_scene(generator, gaussians=8, width=20, height=16))
