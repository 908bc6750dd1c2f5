"""What the tests of several commands share."""

import numpy as np
import pytest

from gva_mi.body.pose import save_poses


@pytest.fixture
def scene(tmp_path):
    """A file with 8 Gaussians before a camera."""
    import torch

    from gva_mi.splat.scene import random_scene

    s = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=20, height=16)
    c = s.camera
    arrays = {k: v.numpy() for k, v in s.inputs().items()}
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    np.savez(tmp_path / "scene.npz", **arrays, **camera)
    return tmp_path / "scene.npz"


@pytest.fixture
def run(known, turning, tmp_path):
    """A run's folder: the avatar, and the poses that were trained with it."""
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(3), stage=2)
    return tmp_path / "run"
