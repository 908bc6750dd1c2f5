"""Errors constant in camera axes: tilts of limbs, and misjudged sizes that keep the picture."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.synthetic.error_models.camera_bias import CameraTilt, tilted
from gva_mi.synthetic.error_models.outliers import Outliers
from gva_mi.synthetic.error_models.poses import (
    JointFactors,
    PoseErrors,
    estimated_camera,
    noisy_poses,
)

NOTHING = PoseErrors(
    sizes=JointFactors(0, 0, 0, 0, 0), depth=0, aside=0, betas=0, expression=0,
    outliers=Outliers(lost=0),
)  # fmt: skip


def rng():
    return np.random.default_rng(4)


def in_camera_axes(rotations, camera):
    """Return global rotations (T, 55, 3, 3) of joints, in camera axes."""
    joints, transl = torch.zeros(55, 3).double(), torch.zeros(len(rotations), 3).double()
    R = joint_transforms(torch.as_tensor(rotations), joints, PARENTS, transl)[..., :3, :3].numpy()
    return camera.T_camera_world[:3, :3] @ R


@pytest.fixture
def turning_and_bent(turning):
    pose, shape = turning
    pose.rotations[:, 1:] = 0.3 * torch.from_numpy(rng().normal(size=(24, 54, 3))).float()
    return pose, shape


def test_a_tilt_is_one_rotation_in_camera_axes_while_the_person_turns(turning_and_bent, camera):
    rotations = turning_and_bent[0].rotations.double().numpy()
    lean = CameraTilt(legs=0.1, trunk=0.04, arms=0.06)
    before = in_camera_axes(rotations, camera)
    after = in_camera_axes(tilted(rotations, camera, lean), camera)
    L = after @ before.swapaxes(-1, -2)
    for names, angle in (
        (("left_hip", "right_knee", "left_foot"), -0.1),
        (("spine1", "head", "left_collar"), 0.04),
        (("left_shoulder", "right_wrist"), 0.04 - 0.06),
        (("pelvis",), 0.0),
    ):
        cos, sin = np.cos(angle), np.sin(angle)
        about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        for name in names:
            assert np.abs(L[:, JOINTS.index(name)] - about_x).max() < 1e-6, name


def pixels(body, found, camera):
    return camera.project(body(*found).vertices[:, ::50].double().numpy())


def test_a_person_estimated_larger_is_placed_farther_and_keeps_the_picture(body, turning, camera):
    """Only proportions change the picture: less than a quarter of the growth."""
    spread = lambda x: np.sqrt(((x - x[:, :1]) ** 2).mean())
    joints = lambda found: body(*found).joints.double().numpy()[:, :22]
    noise = replace(NOTHING, betas=0.6, depth_follows=True)
    grown, left = [], []
    for seed in range(6):
        larger = noisy_poses(body, *turning, camera, noise, 1.0, np.random.default_rng(seed))
        grown.append(spread(joints(larger)) / spread(joints(turning)) - 1)
        seen, true = (camera.project(joints(found)) for found in (larger, turning))
        left.append(spread(seen) / spread(true) - 1)
        assert np.abs(seen[:, 0] - true[:, 0]).max() < 0.01  # px, the pelvis
    assert np.abs(grown).mean() > 0.02
    assert np.abs(left).mean() < 0.25 * np.abs(grown).mean()


def test_another_focal_length_moves_the_person_and_keeps_the_picture(body, turning, camera):
    noise = replace(NOTHING, focal=0.1)
    found = noisy_poses(body, *turning, camera, noise, 1.0, rng())
    estimated = estimated_camera(camera, noise, 1.0)
    assert estimated.fx == pytest.approx(1.1 * camera.fx) and estimated.cx == camera.cx
    off = pixels(body, found, estimated) - pixels(body, turning, camera)
    assert np.abs(off).max() < 0.025 * 64  # of the picture's width; perspective alone is left
    z = (found[0].transl - turning[0].transl).double().numpy() @ camera.T_camera_world[2, :3]
    assert np.allclose(z, 0.1 * 3, atol=0.05)  # m, of 3
