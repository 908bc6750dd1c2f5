"""Forward kinematics against a step-by-step reference, with exact derivatives."""

import pytest
import roma
import torch

from gva_mi.body.kinematics import joint_transforms, turn_joints
from gva_mi.body.pose import PARENTS

F64 = torch.float64
FEW = (-1, 0, 0, 1, 3)  # a small tree, for what is checked entry by entry


def moves(angle=0.4, joints=55):
    """Rotations of about ``angle`` in two frames, joints in reach of each other, translations."""
    g = torch.Generator().manual_seed(3)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    return angle * normal(2, joints, 3), 0.5 * normal(joints, 3), normal(2, 3)


def reference(rotations, joints, transl):
    """Reference implementation: from the root outward, joint by joint."""
    R = roma.rotvec_to_rotmat(rotations)
    T = []
    for joint, parent in enumerate(PARENTS):
        offset = joints[joint] - (joints[parent] if joint else 0)
        top = torch.cat([R[:, joint], offset.expand(2, 3).unsqueeze(-1)], dim=2)
        local = torch.cat([top, top.new_tensor([[[0, 0, 0, 1.0]]]).expand(2, 1, 4)], dim=1)
        T.append(T[parent] @ local if joint else local)
    G = torch.stack(T, dim=1)
    t = G[..., :3, 3] - (G[..., :3, :3] @ joints.unsqueeze(-1)).squeeze(-1) + transl.unsqueeze(1)
    top = torch.cat([G[..., :3, :3], t.unsqueeze(-1)], dim=-1)
    return R, torch.cat([top, G[..., 3:, :]], dim=-2)


def test_agrees_with_the_reference_implementation():
    inputs = moves()
    for x, y in zip(turn_joints(*inputs[:2], PARENTS, inputs[2]), reference(*inputs), strict=True):
        torch.testing.assert_close(x, y)


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
