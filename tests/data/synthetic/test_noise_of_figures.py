"""Noise over a figure that the fitted body does not span: it starts from the nearest one it has."""

import json

import numpy as np
import pytest
import torch

from gva_mi.body.pose import load_poses
from gva_mi.data.synthetic import SynthOptions, degrade, make_subject
from gva_mi.data.truth import load_truth

SMALL = dict(
    seed=21, figure="stretched", frames=2, size=32, samples=1, novel_poses=0, novel_views=0,
    clothes=False, hair=False,
)  # fmt: skip


@pytest.mark.slow
def test_a_figure_has_the_same_poses_whether_noise_is_drawn_at_once_or_later(tmp_path, body):
    take = tmp_path / "take"
    make_subject(take, SynthOptions(**SMALL), body)
    make_subject(tmp_path / "once", SynthOptions(**SMALL, family="white", noise_seed=3), body)
    degrade(take, tmp_path / "later", "white", 3, body)
    once, later = (load_poses(tmp_path / name / "poses.npz")[0] for name in ("once", "later"))
    torch.testing.assert_close(once.rotations, later.rotations, atol=1e-5, rtol=0)
    torch.testing.assert_close(once.transl, later.transl, atol=1e-5, rtol=0)

    degrade(take, tmp_path / "exact", "white", 3, body, level=0.0)
    pose, shape = load_poses(tmp_path / "exact/poses.npz")
    truth = load_truth(tmp_path / "exact/truth", body)
    assert truth.foreign
    apart = body(pose, shape).joints - truth.body(truth.pose, truth.shape).joints
    floor = json.loads((tmp_path / "exact/noise.json").read_text())["floor"]
    np.testing.assert_allclose(1e3 * apart.norm(dim=2).mean(), floor["joint_mm"], rtol=1e-3)
