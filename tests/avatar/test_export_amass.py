"""Poses as AMASS has them: the keys, and the order of the joints in them."""

import numpy as np
import torch

from gva_mi.avatar.export import save_amass
from gva_mi.body.pose import Pose, Shape


def test_keys_and_order_are_those_of_amass(tmp_path):
    rotations = torch.arange(4 * 165, dtype=torch.float32).view(4, 55, 3) / 1000
    pose = Pose(rotations, torch.rand(4, 3), torch.rand(4, 10))
    save_amass(tmp_path / "a.npz", pose, Shape(torch.linspace(-1, 1, 10)), fps=30)
    data = dict(np.load(tmp_path / "a.npz"))
    named = {name: value.numpy() for name, value in pose.to_smplx().items()}
    assert data["poses"].shape == (4, 165)
    parts = {"global_orient": (0, 3), "body_pose": (3, 66), "jaw_pose": (66, 69),
             "leye_pose": (69, 72), "reye_pose": (72, 75), "left_hand_pose": (75, 120),
             "right_hand_pose": (120, 165)}  # fmt: skip
    for name, (first, last) in parts.items():
        assert np.array_equal(data["poses"][:, first:last], named[name]), name
    assert np.array_equal(data["trans"], pose.transl) and data["betas"].shape == (10,)
    assert str(data["gender"]) == "neutral" and str(data["surface_model_type"]) == "smplx"
    assert float(data["mocap_frame_rate"]) == 30
