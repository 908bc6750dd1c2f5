"""A long training run does not fill the memory."""

import math
import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gva_mi.splat import Screen, render
from gva_mi.splat.camera import look_at
from gva_mi.splat.scene import random_scene


def resident() -> int:
    """Memory of this process, bytes."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads the memory on Linux")
def test_memory_is_flat_over_3000_poses():
    s = random_scene(torch.Generator().manual_seed(0), 2000, 128, 128, degree=1).to(torch.float32)
    s.gaussians.scales.data.mul_(0.3)
    after = []
    for k in range(3000):
        angle = 0.37 * k  # the number of pairs is another one every time
        eye = (2.9 * math.sin(angle), 0.4 * math.cos(0.1 * k), 2.9 * math.cos(angle))
        camera = replace(s.camera, T_camera_world=look_at(eye, (0.0, 0.0, 0.0)))
        image = render(s.gaussians, camera, s.options, s.background, Screen())
        image.color.square().sum().backward()
        for tensor in s.inputs().values():
            tensor.grad = None
        if k % 500 == 499:
            after.append(resident())
    assert max(after[2:]) - after[1] < 8e6, after
