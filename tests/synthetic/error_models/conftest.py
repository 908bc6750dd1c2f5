"""A camera, a person who turns once, and a ball as a mask with its normals."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.splat import Camera, look_at


@pytest.fixture(scope="session")
def camera():
    return Camera(80, 80, 32, 32, look_at((0, 1, 3), (0, 1, 0)), 64, 64)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def turning():
    """Poses of 24 frames and a shape."""
    pose = Pose.rest(24)
    pose.rotations[:, 0, 1] = torch.arange(24) * (2 * torch.pi / 24)
    return pose, Shape(torch.zeros(10))


@pytest.fixture
def disc():
    """A ball seen from the front: mask (H, W), normals (H, W, 3)."""
    y, x = np.mgrid[:64, :64] - 31.5
    r = np.hypot(x, y) / 24
    z = -np.sqrt(np.maximum(1 - r**2, 0))
    inside = r < 1
    normals = np.stack([x / 24, y / 24, z], axis=-1) * inside[..., None]
    return np.clip(24.5 - 24 * r, 0, 1).astype(np.float32), normals.astype(np.float32)
