"""The prior of stage 2 is learned from errors of videos; here, drawn from a known law."""

import numpy as np
import pytest
import torch

from gva_mi.prior.error_model import GROUPS, STAGE1_MEMORY
from gva_mi.prior.inference import PLACE_AXES
from tools.stage1_errors import SolvedTrack, learn, table

SLOW, LAG, BIAS = 0.05, 0.1, 0.04  # LAG in seconds
FPS = 10.0  # frames a second of the videos


def drawn(seed, joints=6, frames=60):
    """Errors of joints of which each moves at its own speed; every second one rests at first."""
    rng, seconds = np.random.default_rng(seed), np.arange(frames) / FPS
    x = 3**0.5 * np.abs(seconds[:, None] - seconds) / STAGE1_MEMORY
    root = np.linalg.cholesky((1 + x) * np.exp(-x) + 1e-9 * np.eye(frames))
    speed = rng.uniform(0, 2, joints) * np.ones((frames, 1))  # radians a second, of a coordinate
    speed[: frames // 2, ::2] = 0
    unit = np.einsum("kl,lcd->kcd", root, rng.normal(size=(frames, joints, 3)))
    size = np.hypot(SLOW, LAG * speed)[..., None]
    errors = size * unit + BIAS * rng.normal(size=(joints, 3))
    steps = np.repeat(speed[1:, :, None] / FPS, 3, 2)
    return SolvedTrack(*(torch.from_numpy(x).float() for x in (errors, steps, seconds)))


def test_the_law_of_the_errors_is_found_although_one_video_went_wrong():
    recordings = [drawn(seed) for seed in range(9)]
    recordings[0] = recordings[0]._replace(errors=20 * recordings[0].errors)
    found = learn([dict.fromkeys((*GROUPS, *PLACE_AXES), recording) for recording in recordings])[
        "elbows"
    ]
    assert found.slow == pytest.approx(SLOW, rel=0.25)
    assert found.lag == pytest.approx(LAG, rel=0.25)
    assert found.bias == pytest.approx(BIAS, rel=0.4)
    (row,) = table({"elbows": found})
    assert row.startswith(f'"elbows": ({np.degrees(found.slow):.1f}, ')
