"""Noise at level 0 is the truth; above it, it is what it says."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.data.synthetic import noise
from gva_mi.splat import Camera, look_at

CAMERA = Camera(80, 80, 32, 32, look_at((0, 1, 3), (0, 1, 0)), 64, 64)


def random():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture
def truth():
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


def test_level_zero_is_exact(truth, disc):
    pose, shape = noise.noisy_poses(*truth, CAMERA, 0.0, random())
    assert torch.equal(pose.rotations, truth[0].rotations) and torch.equal(
        shape.betas, truth[1].betas
    )
    mask, normals = disc
    assert np.array_equal(noise.noisy_mask(mask, 0.0, random()), mask)
    assert np.array_equal(noise.noisy_normals(normals, mask, 0.0, random()), normals)


def test_poses_are_wrong_by_the_usual_amount_and_worst_at_hands_and_feet(body, truth):
    noisy = noise.noisy_poses(*truth, CAMERA, 1.0, random())
    error = noise.pose_error(body, *noisy, *truth, CAMERA)
    assert 40 < error.vertex_mm < 100
    assert error.hand_vertex_mm > error.vertex_mm and error.foot_vertex_mm > error.vertex_mm


def test_pose_error_grows_with_the_level(body, truth):
    errors = [
        noise.pose_error(body, *noise.noisy_poses(*truth, CAMERA, level, random()), *truth, CAMERA)
        for level in (0.25, 0.5, 1.0)
    ]
    assert errors[0].vertex_mm < errors[1].vertex_mm < errors[2].vertex_mm


def test_rotation_errors_grow_along_the_limbs():
    pose, shape = Pose.rest(2000), Shape(torch.zeros(10))
    noisy, _ = noise.noisy_poses(pose, shape, CAMERA, 1.0, random())
    size = noisy.rotations.pow(2).sum(-1).mean(0).sqrt()
    of = lambda name: (size[JOINTS.index(f"left_{name}")] + size[JOINTS.index(f"right_{name}")]) / 2
    assert size[JOINTS.index("spine1")] < of("collar") < of("shoulder") < of("elbow") < of("wrist")
    assert size[JOINTS.index("pelvis")] < of("hip") < of("knee") < of("ankle")
    assert of("index2") > 2 * size[JOINTS.index("spine3")]


def test_depth_is_known_worst():
    pose, shape = Pose.rest(2000), Shape(torch.zeros(10))
    noisy, _ = noise.noisy_poses(pose, shape, CAMERA, 1.0, random())
    R = torch.tensor(CAMERA.T_camera_world[:3, :3].tolist())
    x, y, z = ((noisy.transl - pose.transl) @ R.T).std(0)
    assert z > 2 * x and z > 2 * y


def test_rotation_errors_double_sideways():
    pose, shape = Pose.rest(400), Shape(torch.zeros(10))
    pose.rotations[200:, 0, 1] = torch.pi / 2
    noisy, _ = noise.noisy_poses(pose, shape, CAMERA, 1.0, random())
    size = (noisy.rotations - pose.rotations)[:, 1:].pow(2).sum(-1).mean(1)
    ratio = (size[200:].mean() / size[:200].mean()).sqrt()
    assert 1.8 < ratio < 2.2


def test_errors_come_in_bursts():
    pose, shape = Pose.rest(600), Shape(torch.zeros(10))
    noisy, _ = noise.noisy_poses(pose, shape, CAMERA, 1.0, random())
    elbow = noisy.rotations[:, JOINTS.index("left_elbow")].norm(dim=-1)
    spine = noisy.rotations[:, JOINTS.index("spine1")].norm(dim=-1)
    heaviness = lambda x: (x**4).mean() / (x**2).mean() ** 2
    assert heaviness(elbow) > 1.3 * heaviness(spine)


def test_a_lost_hand_is_the_mean_hand_on_a_straight_wrist_and_is_counted(body):
    pose, shape = Pose.rest(400), Shape(torch.zeros(10))
    pose.rotations[:, LEFT_HAND] = 0.5
    noisy, _ = noise.noisy_poses(pose, shape, CAMERA, 1.0, random())
    error = noise.pose_error(body, noisy[:60], shape, pose[:60], shape, CAMERA)
    lost = (noisy.rotations[:, LEFT_HAND] - torch.tensor(noise._mean_hand("left")).float()).abs()
    lost = lost.amax((1, 2)) < 1e-5
    assert 0.02 < lost.float().mean() < 0.2
    wrist = JOINTS.index("left_wrist")
    assert (noisy.rotations[lost, wrist] == 0).all()
    assert (noisy.rotations[~lost, wrist].norm(dim=-1) > 0).all()
    assert error.lost_left_hand == tuple(torch.nonzero(lost[:60]).flatten().tolist())
    runs = (lost[1:] & ~lost[:-1]).sum()
    assert lost.sum() / runs > 2  # frames in a row


def test_nobody_loses_a_hand_at_level_zero():
    assert not noise.dropped_frames(500, 0.0, random()).any()


def test_pose_errors_persist_over_frames(truth):
    noisy, _ = noise.noisy_poses(*truth, CAMERA, 1.0, random())
    error = (noisy.rotations - truth[0].rotations)[:, BODY]
    step = error.diff(dim=0)
    assert step.pow(2).mean() < 0.3 * error.pow(2).mean()


def test_a_mask_is_off_at_its_boundary_only(disc):
    mask, _ = disc
    noisy = noise.noisy_mask(mask, 1.0, random())
    y, x = np.mgrid[:64, :64] - 31.5
    r = np.hypot(x, y)
    assert not np.array_equal(noisy, mask)
    assert (noisy[r < 20] == 1).all() and (noisy[r > 28] == 0).all()
    assert noise.mask_iou(noisy, mask) > 0.9


def test_normals_stay_unit_face_the_camera_and_fill_the_mask(disc):
    mask, normals = disc
    wider = (np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 26).astype(np.float32)
    noisy = noise.noisy_normals(normals, wider, 1.0, random())
    length = np.linalg.norm(noisy, axis=-1)
    assert np.allclose(length[wider > 0.5], 1, atol=1e-5) and (length[wider <= 0.5] == 0).all()
    assert (noisy[..., 2] <= 0).all()
    assert 2 < noise.normal_error(noisy, normals) < 20


def test_errors_of_normals_vary_slowly():
    flat = np.zeros((128, 128, 3), np.float32)
    flat[..., 2] = -1
    full = np.ones((128, 128), np.float32)
    error = noise.noisy_normals(flat, full, 1.0, random())[..., :2]
    size = np.sqrt((error**2).mean())
    step = np.sqrt((np.diff(error, axis=1) ** 2).mean())
    assert 0.05 < size < 0.3 and step < 0.25 * size  # a tilt that lasts over many pixels


def test_normals_are_blurred_like_a_networks():
    ridge = np.zeros((64, 512, 3), np.float32)
    ridge[:, :256], ridge[:, 256:] = (-0.8, 0, -0.6), (0.8, 0, -0.6)
    blurred = noise.noisy_normals(ridge, np.ones((64, 512), np.float32), 1.0, random())
    row = blurred[30, 246:266, 0]
    assert np.diff(row).max() < 0.4 * 1.6  # of the true step, which was between two pixels
    assert row[-1] - row[0] > 1.2


def test_an_empty_mask_stays_empty():
    empty = np.zeros((16, 16), np.float32)
    assert not noise.noisy_mask(empty, 1.0, random()).any()
    assert not noise.noisy_normals(np.zeros((16, 16, 3), np.float32), empty, 1.0, random()).any()
