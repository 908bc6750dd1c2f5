"""Derivatives of forward kinematics, whose values the references of whole bodies check."""

import pytest
import torch

from gva_mi.body.kinematics import joint_transforms, turn_joints

F64 = torch.float64
FEW = (-1, 0, 0, 1, 3)  # a small tree, for what is checked entry by entry


def moves(angle=0.4, joints=55):
    """Rotations of about ``angle`` in two frames, joints in reach of each other, translations."""
    g = torch.Generator().manual_seed(3)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    return angle * normal(2, joints, 3), 0.5 * normal(joints, 3), normal(2, 3)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 3.0])
@pytest.mark.parametrize("shared", [True, False], ids=["one skeleton", "one a frame"])
def test_gradients_against_differences(angle, shared):
    rotations, joints, transl = moves(angle=angle, joints=len(FEW))
    joints = joints if shared else torch.stack([joints, joints.flip(0)])
    torch.autograd.gradcheck(
        lambda r, j, t: turn_joints(r, j, FEW, t),
        [x.clone().requires_grad_() for x in (rotations, joints, transl)],
        check_forward_ad=True,
    )


def test_a_tree_in_the_wrong_order_is_refused():
    zero = torch.zeros(1, 3, 3)
    with pytest.raises(ValueError, match="every parent before its children"):
        joint_transforms(zero, zero[0], (-1, 2, 0), zero[:, 0])
    with pytest.raises(ValueError, match=r"rotations must be \(T, 4, 3\), got \(1, 3, 3\)"):
        joint_transforms(zero, zero[0], (-1, 0, 0, 0), zero[:, 0])
