"""What the tests of several commands share."""

import pytest
from samples.scenes import few_gaussians

from gva_mi.body.pose import save_poses


@pytest.fixture
def scene(tmp_path):
    """A file with 8 Gaussians before a camera."""
    return few_gaussians(tmp_path / "scene.ply")


@pytest.fixture
def run(known, turning, tmp_path):
    """A run's folder: the avatar, and the poses that were trained with it."""
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(3), stage=2)
    return tmp_path / "run"
