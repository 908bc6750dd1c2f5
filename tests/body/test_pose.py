"""Poses and their files."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, SMPLX_FIELDS, Pose, Shape, load_poses, save_poses


@pytest.fixture
def pose():
    normal = lambda *size: torch.randn(*size, generator=torch.Generator().manual_seed(0))
    return Pose(normal(4, 55, 3), normal(4, 3), normal(4, 7))


def test_fields_of_smplx_follow_each_other_in_the_order_of_joints():
    joints = [k for part in SMPLX_FIELDS.values() for k in range(len(JOINTS))[part]]
    assert joints == list(range(len(JOINTS)))
    assert all(JOINTS[k].startswith("left_") for k in range(55)[SMPLX_FIELDS["left_hand_pose"]])


def test_smplx_s_names_and_back(pose):
    named = pose.to_smplx()
    assert [tuple(value.shape) for value in named.values()] == [
        (4, 3), (4, 63), (4, 3), (4, 3), (4, 3), (4, 45), (4, 45), (4, 3), (4, 7),
    ]  # fmt: skip
    again = Pose.from_smplx(named)
    for name in ("rotations", "transl", "expression"):
        assert torch.equal(getattr(again, name), getattr(pose, name))


def test_a_file_holds_smplx_s_names_in_their_order(pose, tmp_path):
    save_poses(tmp_path / "poses.npz", pose, Shape(torch.zeros(3)), stage=1)
    with np.load(tmp_path / "poses.npz") as file:
        assert file.files == [*pose.to_smplx(), "betas", "stage"]
    again, shape = load_poses(tmp_path / "poses.npz")
    assert torch.equal(again.rotations, pose.rotations) and len(shape.betas) == 3


def test_wrong_rotations_are_refused():
    with pytest.raises(ValueError, match=r"rotations must be \(T, 55, 3\), got \(2, 165\)"):
        Pose(torch.zeros(2, 165), torch.zeros(2, 3), torch.zeros(2, 10))
