"""LBS of points and Gaussians: rigid motions, polar factors, exact derivatives."""

import pytest
import roma
import torch
import torch.autograd.forward_ad as forward

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.polar import apply_lbs
from gva_mi.body.pose import PARENTS
from gva_mi.body.skinning import skin_points, strongest

F64 = torch.float64


def rotation(quats):
    """Convert quaternions (N, 4) wxyz of any length to (N, 3, 3)."""
    unit = quats / quats.norm(dim=-1, keepdim=True)
    return roma.unitquat_to_rotmat(roma.quat_wxyz_to_xyzw(unit))


FEW = (-1, 0, 0, 1, 3)  # a small tree, for what is checked entry by entry


def blend(weights, T_world_rest):
    """LBS transforms (N, 12)."""
    return weights @ T_world_rest[:, :3].flatten(1)


def skin_gaussians(means, quats, weights, T_world_rest):
    return apply_lbs(blend(weights, T_world_rest), means, quats)


def scene(n=40, angle=0.3, dtype=F64, seed=0, parents=PARENTS):
    """Random Gaussians on a random skeleton whose joints turn by about ``angle`` each."""
    joints = len(parents)
    g = torch.Generator().manual_seed(seed)
    normal = lambda *size: torch.randn(*size, generator=g, dtype=F64)
    weights = strongest(torch.rand(n, joints, generator=g, dtype=F64) ** 4)
    rotations = angle * normal(1, joints, 3)
    T = joint_transforms(rotations, normal(joints, 3), parents, normal(1, 3))[0]
    return tuple(x.to(dtype) for x in (normal(n, 3), normal(n, 4), weights, T))


def test_means_are_skinned_like_points_and_quaternions_keep_their_length():
    means, quats, weights, T = scene()
    moved, turned = skin_gaussians(means, quats, weights, T)
    both = skin_points(means, weights, torch.stack([T, scene(seed=4)[3]]))
    torch.testing.assert_close(moved, both[0])
    torch.testing.assert_close(both[1], skin_points(means, weights, scene(seed=4)[3]))
    torch.testing.assert_close(turned.norm(dim=1), quats.norm(dim=1))


def test_a_rigid_motion_turns_gaussians_exactly():
    means, quats, weights, _ = scene()
    R = roma.rotvec_to_rotmat(torch.tensor([1.3, -2.0, 0.4], dtype=F64))
    T = torch.eye(4, dtype=F64)
    T[:3, :3], T[:3, 3] = R, torch.tensor([0.1, 2.0, -3.0], dtype=F64)
    moved, turned = skin_gaussians(means, quats, weights, T.expand(55, 4, 4))
    torch.testing.assert_close(moved, means @ R.T + T[:3, 3])
    torch.testing.assert_close(rotation(turned), R @ rotation(quats))


@pytest.mark.parametrize("angle", [0.1, 1.0])
def test_orientations_follow_the_polar_factor(angle):
    means, quats, weights, T = scene(n=300, angle=angle)
    U, S, Vh = torch.linalg.svd(blend(weights, T).unflatten(1, (3, 4))[..., :3])
    sign = torch.linalg.det(U @ Vh)
    U[..., -1] *= sign[:, None]  # the nearest rotation, never a reflection
    clear = S[:, 1] + sign * S[:, 2] > 0.05  # elsewhere the nearest rotation is hardly defined
    assert clear.sum() > 200
    _, turned = skin_gaussians(means, quats, weights, T)
    torch.testing.assert_close(rotation(turned)[clear], ((U @ Vh) @ rotation(quats))[clear])


@pytest.mark.parametrize("name", ["means", "quats", "weights", "T_world_rest"])
def test_gradients_against_differences(name):
    names = ("means", "quats", "weights", "T_world_rest")
    values = dict(zip(names, scene(n=3, seed=6, parents=FEW), strict=True))
    leaf = values[name].clone().requires_grad_()
    torch.autograd.gradcheck(
        lambda x: skin_gaussians(**(values | {name: x})), leaf, check_forward_ad=True
    )


def test_opposite_joints_give_finite_gradients():
    means, quats, _, _ = scene(n=1)
    T = torch.eye(4, dtype=F64).repeat(2, 1, 1)
    T[1, :3, :3] = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=F64))
    T.requires_grad_()
    _, turned = skin_gaussians(means, quats, torch.full((1, 2), 0.5, dtype=F64), T)
    turned.sum().backward()
    assert turned.isfinite().all() and T.grad.isfinite().all()


def test_the_tangent_of_points_is_that_of_central_differences():
    """Of points that all poses share, their weights and the transforms, together."""
    means, _, weights, T = scene()
    poses = torch.stack([T, scene(seed=4)[3]])
    g = torch.Generator().manual_seed(1)
    given = means, weights, poses
    along = [torch.randn(x.shape, generator=g, dtype=F64) for x in given]
    along[2][..., 3, :] = 0
    step = 1e-6
    ends = (skin_points(*(x + s * dx for x, dx in zip(given, along, strict=True)))
            for s in (step, -step))  # fmt: skip
    high, low = ends
    with forward.dual_level():
        dual = skin_points(*map(forward.make_dual, given, along))
        tangent = forward.unpack_dual(dual).tangent
    torch.testing.assert_close(tangent, (high - low) / (2 * step), rtol=1e-7, atol=1e-8)
