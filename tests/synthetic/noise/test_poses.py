"""Error model of poses: zero at level 0, otherwise as its parameters say."""

from dataclasses import replace

import numpy as np
import torch

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, Pose, Shape
from gva_mi.synthetic.error_models.measure import pose_error
from gva_mi.synthetic.error_models.outliers import mean_hand
from gva_mi.synthetic.error_models.poses import PoseErrors, noisy_poses

USUAL = PoseErrors()


def seeded():
    return np.random.default_rng(0)


def test_level_zero_is_exact(body, turning, camera):
    pose, shape = noisy_poses(body, *turning, camera, USUAL, 0.0, seeded())
    assert pose is turning[0] and shape is turning[1]


def test_poses_keep_their_numbers(body, turning, camera):
    """The figures of the demo depend on these numbers."""
    pose, shape = noisy_poses(body, *turning, camera, USUAL, 1.0, seeded())
    elbow = pose.rotations[:, JOINTS.index("left_elbow")]
    close = lambda x, *numbers: np.allclose(x, numbers, rtol=0, atol=2e-6)
    assert close(elbow[3], -0.081424, 0.023198, 0.470646)
    assert close(elbow[17], 0.072116, -0.065876, 0.059867)
    assert close(pose.transl[17], 0.004823, 0.019650, -0.084871)
    assert close(shape.betas[:3], -0.072166, 0.018831, -0.334528)


def test_pose_errors_are_largest_at_hands_and_feet(body, turning, camera):
    noisy = noisy_poses(body, *turning, camera, USUAL, 1.0, seeded())
    error = pose_error(body, *noisy, *turning, camera)
    assert 40 < error.vertex_mm < 100
    assert error.hand_vertex_mm > error.vertex_mm and error.foot_vertex_mm > error.vertex_mm


def test_depth_has_the_largest_error(body, camera):
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


def test_a_lost_hand_is_the_mean_hand_and_is_counted(body, camera):
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


def error_of(noise, body, camera, frames=400):
    """Return rotation errors (T, 21, 3) of a standing person."""
    pose, shape = Pose.rest(frames), Shape(torch.zeros(10))
    return noisy_poses(body, pose, shape, camera, noise, 1.0, seeded())[0].rotations[:, BODY]


def correlation(error, lag):
    return float((error[lag:] * error[:-lag]).mean() / error.pow(2).mean())


def test_white_noise_is_independent_from_frame_to_frame(body, camera):
    still = replace(USUAL, outliers=replace(USUAL.outliers, lost=0.0))
    for lag in (1, 3, 10):
        assert abs(correlation(error_of(replace(still, white=1.0), body, camera), lag)) < 0.03
        assert correlation(error_of(still, body, camera), lag) > 0.3 * (lag < 10)


def test_slow_noise_persists_over_its_memory(body, camera):
    """The autocorrelation of a curve smoothed over σ frames is exp(-lag² / 4σ²)."""
    noise = replace(USUAL, memory=18.0, calm=1.0, burst=1.0)
    noise = replace(noise, outliers=replace(USUAL.outliers, lost=0.0))
    error = error_of(noise, body, camera, 1500)
    for lag in (5, 18, 36):
        assert abs(correlation(error, lag) - np.exp(-(lag**2) / (4 * 18**2))) < 0.08
