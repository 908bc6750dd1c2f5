"""A tiny subject in the folder format, made of noise: three frames of 8 x 6 pixels."""

import numpy as np
import pytest

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.splat import Camera, look_at
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import write_image

WIDTH, HEIGHT, FRAMES = 8, 6, 3


@pytest.fixture
def subject(tmp_path):
    random = np.random.default_rng(0)
    folder = tmp_path / "subject"
    for k in range(FRAMES):
        frame = random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[1:5, 2:6] = 255
        write_image(folder / f"frames/{k:06d}.png", frame)
        write_image(folder / f"masks/{k:06d}.png", mask)
    import torch

    save_poses(folder / "poses.npz", Pose.rest(FRAMES), Shape(torch.zeros(10)), stage=1)
    camera = Camera(10, 10, 4, 3, look_at((0, 0, 3), (0, 0, 0)), WIDTH, HEIGHT)
    save_cameras(folder / "cameras.npz", [camera] * FRAMES)
    return folder
