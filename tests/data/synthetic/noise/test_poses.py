"""Noise of poses: none at level 0, and above it what its parameters say."""

from dataclasses import replace

import numpy as np
import torch
from gva_mi.data.synthetic.noise.errors import pose_error

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, Pose, Shape
from gva_mi.data.synthetic.noise.outliers import mean_hand
from gva_mi.data.synthetic.noise.poses import JointFactors, PoseNoise, noisy_poses

USUAL = PoseNoise()


def seeded():
    return np.random.default_rng(0)


def test_level_zero_is_exact(body, turning, camera):
    pose, shape = noisy_poses(body, *turning, camera, USUAL, 0.0, seeded())
    assert pose is turning[0] and shape is turning[1]


def test_bursts_are_drawn_as_they_always_were(body, turning, camera):
    """Numbers of the model that the demo's figures hang on."""
    pose, shape = noisy_poses(body, *turning, camera, USUAL, 1.0, seeded())
    elbow = pose.rotations[:, JOINTS.index("left_elbow")]
    close = lambda x, *numbers: np.allclose(x, numbers, rtol=0, atol=2e-6)
    assert close(elbow[3], -0.081424, 0.023198, 0.470646)
    assert close(elbow[17], 0.072116, -0.065876, 0.059867)
    assert close(pose.transl[17], 0.004823, 0.019650, -0.084871)
    assert close(shape.betas[:3], -0.072166, 0.018831, -0.334528)


def test_poses_are_wrong_by_the_usual_amount_and_worst_at_hands_and_feet(body, turning, camera):
    noisy = noisy_poses(body, *turning, camera, USUAL, 1.0, seeded())
    error = pose_error(body, *noisy, *turning, camera)
    assert 40 < error.vertex_mm < 100
    assert error.hand_vertex_mm > error.vertex_mm and error.foot_vertex_mm > error.vertex_mm


def test_pose_error_grows_with_the_level(body, turning, camera):
    errors = [
        pose_error(
            body, *noisy_poses(body, *turning, camera, USUAL, level, seeded()), *turning, camera
        )
        for level in (0.25, 0.5, 1.0)
    ]
    assert errors[0].vertex_mm < errors[1].vertex_mm < errors[2].vertex_mm


def test_rotation_errors_grow_along_the_limbs(body, camera):
    pose, shape = Pose.rest(2000), Shape(torch.zeros(10))
    noisy, _ = noisy_poses(body, pose, shape, camera, USUAL, 1.0, seeded())
    size = noisy.rotations.pow(2).sum(-1).mean(0).sqrt()
    of = lambda name: (size[JOINTS.index(f"left_{name}")] + size[JOINTS.index(f"right_{name}")]) / 2
    assert size[JOINTS.index("spine1")] < of("collar") < of("shoulder") < of("elbow") < of("wrist")
    assert size[JOINTS.index("pelvis")] < of("hip") < of("knee") < of("ankle")
    assert of("index2") > 2 * size[JOINTS.index("spine3")]


def test_depth_is_known_worst(body, camera):
    pose, shape = Pose.rest(2000), Shape(torch.zeros(10))
    noisy, _ = noisy_poses(body, pose, shape, camera, USUAL, 1.0, seeded())
    R = torch.tensor(camera.T_camera_world[:3, :3].tolist())
    x, y, z = ((noisy.transl - pose.transl) @ R.T).std(0)
    assert z > 2 * x and z > 2 * y


def test_rotation_errors_double_sideways(body, camera):
    pose, shape = Pose.rest(400), Shape(torch.zeros(10))
    pose.rotations[200:, 0, 1] = torch.pi / 2
    noisy, _ = noisy_poses(body, pose, shape, camera, USUAL, 1.0, seeded())
    size = (noisy.rotations - pose.rotations)[:, 1:].pow(2).sum(-1).mean(1)
    ratio = (size[200:].mean() / size[:200].mean()).sqrt()
    assert 1.8 < ratio < 2.2


def test_errors_come_in_bursts(body, camera):
    pose, shape = Pose.rest(600), Shape(torch.zeros(10))
    noisy, _ = noisy_poses(body, pose, shape, camera, USUAL, 1.0, seeded())
    elbow = noisy.rotations[:, JOINTS.index("left_elbow")].norm(dim=-1)
    spine = noisy.rotations[:, JOINTS.index("spine1")].norm(dim=-1)
    heaviness = lambda x: (x**4).mean() / (x**2).mean() ** 2
    assert heaviness(elbow) > 1.3 * heaviness(spine)


def test_a_lost_hand_is_the_mean_hand_on_a_straight_wrist_and_is_counted(body, camera):
    pose, shape = Pose.rest(400), Shape(torch.zeros(10))
    pose.rotations[:, LEFT_HAND] = 0.5
    noisy, _ = noisy_poses(body, pose, shape, camera, USUAL, 1.0, seeded())
    error = pose_error(body, noisy[:60], shape, pose[:60], shape, camera)
    lost = (noisy.rotations[:, LEFT_HAND] - torch.tensor(mean_hand("left")).float()).abs()
    lost = lost.amax((1, 2)) < 1e-5
    assert 0.02 < lost.float().mean() < 0.2
    wrist = JOINTS.index("left_wrist")
    assert (noisy.rotations[lost, wrist] == 0).all()
    assert (noisy.rotations[~lost, wrist].norm(dim=-1) > 0).all()
    assert error.lost_left_hand == tuple(torch.nonzero(lost[:60]).flatten().tolist())
    runs = (lost[1:] & ~lost[:-1]).sum()
    assert lost.sum() / runs > 2  # frames in a row


def test_pose_errors_persist_over_frames(body, turning, camera):
    noisy, _ = noisy_poses(body, *turning, camera, USUAL, 1.0, seeded())
    error = (noisy.rotations - turning[0].rotations)[:, BODY]
    step = error.diff(dim=0)
    assert step.pow(2).mean() < 0.3 * error.pow(2).mean()


def error_of(noise, body, camera, frames=400):
    """Errors (T, 21, 3) of the rotations of someone who stands still."""
    pose, shape = Pose.rest(frames), Shape(torch.zeros(10))
    return noisy_poses(body, pose, shape, camera, noise, 1.0, seeded())[0].rotations[:, BODY]


def correlation(error, lag):
    return float((error[lag:] * error[:-lag]).mean() / error.pow(2).mean())


def test_white_noise_is_independent_from_frame_to_frame(body, camera):
    still = replace(USUAL, outliers=replace(USUAL.outliers, lost=0.0))
    for lag in (1, 3, 10):
        assert abs(correlation(error_of(replace(still, white=1.0), body, camera), lag)) < 0.03
        assert correlation(error_of(still, body, camera), lag) > 0.3 * (lag < 10)


def test_slow_noise_persists_as_long_as_its_memory_says(body, camera):
    """Smoothed over σ frames, a curve correlates with itself by exp(-lag² / 4σ²)."""
    noise = replace(USUAL, memory=18.0, calm=1.0, burst=1.0)
    noise = replace(noise, outliers=replace(USUAL.outliers, lost=0.0))
    error = error_of(noise, body, camera, 1500)
    for lag in (5, 18, 36):
        assert abs(correlation(error, lag) - np.exp(-(lag**2) / (4 * 18**2))) < 0.08


def test_a_share_of_white_noise_keeps_the_size_of_the_error(body, camera):
    sizes = [
        error_of(replace(USUAL, white=w), body, camera).pow(2).mean().sqrt() for w in (0, 0.5, 1)
    ]
    assert max(sizes) < 1.1 * min(sizes)


def test_a_factor_is_that_of_its_own_joints(body, camera):
    plain = error_of(USUAL, body, camera)
    larger = error_of(replace(USUAL, sizes=JointFactors(legs=2.0)), body, camera)
    legs = [j - 1 for j, name in enumerate(JOINTS[:22]) if name.endswith(("hip", "knee", "foot"))]
    arms = [j - 1 for j, name in enumerate(JOINTS[:22]) if name.endswith(("elbow", "spine2"))]
    assert torch.allclose(larger[:, legs], 2 * plain[:, legs], atol=1e-6)
    assert torch.equal(larger[:, arms], plain[:, arms])
