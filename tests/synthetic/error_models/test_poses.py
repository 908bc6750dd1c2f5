"""Error model of poses: zero at level 0, otherwise as its parameters say."""

from dataclasses import replace

import numpy as np
import torch

from gva_mi.body.pose import BODY, Pose, Shape
from gva_mi.synthetic.error_models.poses import PoseErrors, noisy_poses

USUAL = PoseErrors()


def seeded():
    return np.random.default_rng(0)


def error_of(noise, body, camera, frames=400):
    """Return rotation errors (T, 21, 3) of a standing person."""
    pose, shape = Pose.rest(frames), Shape(torch.zeros(10))
    return noisy_poses(body, pose, shape, camera, noise, 1.0, seeded())[0].rotations[:, BODY]


def correlation(error, lag):
    return float((error[lag:] * error[:-lag]).mean() / error.pow(2).mean())


def test_white_noise_is_independent_from_frame_to_frame(body, camera):
    white = replace(USUAL, white=1.0, outliers=replace(USUAL.outliers, lost=0.0))
    for lag in (1, 3, 10):
        assert abs(correlation(error_of(white, body, camera), lag)) < 0.03
