"""Avatars: unmoved at rest, rigid under root motion, differentiable, and saved to the bit."""

import copy
import dataclasses

import numpy as np
import pytest
import roma
import torch

from gva_mi import InputError
from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.rig import SkinningOptions
from gva_mi.avatar.skin_gaussians import LIGHT_LENGTH
from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.skinning import strongest
from gva_mi.splat.axes import matrices

PLAIN = AvatarOptions(residual=ResidualOptions(enabled=False))


def at_rest(G):
    """Covariances (N, 3, 3) of canonical Gaussians, or of any with quaternions and scales."""
    quats = torch.nn.functional.normalize(G.quats, dim=-1)[:, [1, 2, 3, 0]]
    F = roma.unitquat_to_rotmat(quats) * G.scales[:, None]
    return F @ F.mT


def test_rest_pose_leaves_gaussians_still(make_avatar):
    avatar = make_avatar(PLAIN)
    posed, G = avatar(Pose.rest()), avatar.canonical
    assert torch.allclose(posed.means, G.means, atol=1e-6)
    assert torch.allclose(matrices(posed.covars), at_rest(G), rtol=1e-5, atol=1e-9)
    light = LIGHT_LENGTH * avatar.light / avatar.light.norm()
    slopes = (light[:, None] * G.sh[:, 1:]).sum(1, keepdim=True)
    assert torch.allclose(posed.sh, G.sh[:, :1] + slopes, atol=1e-6)
    assert torch.equal(posed.opacities, G.opacities)


def test_root_motion_is_rigid(make_avatar, random_pose):
    """Turning the root about its joint turns means and frames; colours, if the light turns too."""
    avatar = make_avatar(dtype=torch.float64)
    pose = random_pose(0, dtype=torch.float64)
    R = roma.rotvec_to_rotmat(torch.tensor([0.3, 2.0, -0.5], dtype=torch.float64))
    shift = torch.tensor([0.1, -2.0, 0.7], dtype=torch.float64)
    rotations = pose.rotations.clone()
    rotations[0, 0] = roma.rotmat_to_rotvec(R @ roma.rotvec_to_rotmat(rotations[0, 0]))
    moved = dataclasses.replace(pose, rotations=rotations, transl=pose.transl + shift)
    root = avatar.rig.joints[0] + pose.transl[0]

    before = avatar(pose)
    assert not torch.allclose(avatar(moved).sh, before.sh, atol=1e-3)
    with torch.no_grad():
        avatar.light.copy_(R @ avatar.light)
    after = avatar(moved)
    assert torch.allclose(after.means, (before.means - root) @ R.T + root + shift, atol=1e-9)
    turned = R @ matrices(before.covars) @ R.T
    assert torch.allclose(matrices(after.covars), turned, rtol=1e-9, atol=1e-15)
    assert torch.allclose(after.sh, before.sh, atol=1e-9)


def test_without_hand_skeleton_fingers_do_not_move(make_avatar, random_pose):
    pose = random_pose(2)
    rotations = pose.rotations.clone()
    rotations[:, LEFT_HAND] = rotations[:, RIGHT_HAND] = 0
    still = dataclasses.replace(pose, rotations=rotations)
    avatar = make_avatar(AvatarOptions(hands=False))
    assert torch.equal(avatar(pose).means, avatar(still).means)
    avatar = make_avatar(AvatarOptions(hands=True))
    assert not torch.allclose(avatar(pose).means, avatar(still).means, atol=1e-3)


def test_without_stretching_gaussians_turn_and_keep_their_size(make_avatar, random_pose):
    """Eq. 6 of the paper."""
    options = AvatarOptions(residual=ResidualOptions(enabled=False), stretch=False)
    avatar, stretched = make_avatar(options), make_avatar(PLAIN)
    posed = avatar(random_pose(0))
    assert posed.covars is None and torch.equal(posed.scales, avatar.canonical.scales)
    other = stretched(random_pose(0))
    assert torch.allclose(posed.means, other.means, atol=1e-6)
    assert not torch.allclose(at_rest(posed), matrices(other.covars), rtol=0.1, atol=0)
    still = avatar(Pose.rest())
    assert torch.allclose(at_rest(still), at_rest(avatar.canonical), rtol=1e-4, atol=1e-9)


def test_colour_of_the_view_is_what_3dgs_evaluates(make_avatar, random_pose):
    """Harmonics of degree 1 in the world's axes, whatever the pose; the light changes nothing."""
    avatar, lit = make_avatar(AvatarOptions(color="view")), make_avatar()
    with torch.no_grad():
        avatar.light.copy_(torch.tensor([0.0, 1.0, 0.0]))
    posed = avatar(random_pose(0))
    assert torch.equal(posed.sh, avatar.canonical.sh) and posed.sh.shape[1] == 4
    assert lit(random_pose(0)).sh.shape[1] == 1


def test_a_saved_avatar_is_the_same_to_the_bit(make_avatar, random_pose, tmp_path):
    avatar = make_avatar(AvatarOptions(seed=SeedOptions(count=700, sh_degree=1), hands=False))
    avatar.save(tmp_path / "avatar.npz")
    loaded = Avatar.load(tmp_path / "avatar.npz")
    assert loaded.options == avatar.options
    assert loaded.rig.body == avatar.rig.body and loaded.rig.parents == avatar.rig.parents
    assert loaded.state_dict().keys() == avatar.state_dict().keys()
    for name, value in avatar.state_dict().items():
        other = loaded.state_dict()[name]
        assert torch.equal(other, value), name
        assert other.stride() == value.stride(), name  # a product's last bit depends on it
    ours, theirs = avatar(random_pose(6)), loaded(random_pose(6))
    for (name, here), there in zip(ours.arrays().items(), theirs.arrays().values(), strict=True):
        assert torch.equal(here, there), name
    assert [file.name for file in tmp_path.iterdir()] == ["avatar.npz"]


def test_other_files_are_refused(make_avatar, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Avatar.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(InputError, match="not a readable .npz"):
        Avatar.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="expected an avatar of this version"):
        Avatar.load(tmp_path / "other.npz")
    arrays = {k: np.asarray(v) for k, v in make_avatar().record().items()}
    del arrays["canonical.quats"]
    np.savez(tmp_path / "cut.npz", **arrays)
    with pytest.raises(InputError, match="canonical.quats"):
        Avatar.load(tmp_path / "cut.npz")


def test_gaussians_on_vertices_follow_the_body(body, random_pose):
    """In all that Eq. 4 does: skeleton, expression, and bulges where joints bend."""
    body, shape = copy.deepcopy(body), Shape(torch.linspace(-1, 1, 10))
    body.weights = strongest(body.weights, SkinningOptions().joints)
    avatar = seed_avatar(body, shape, None, PLAIN)
    pose = random_pose(7)
    psi = torch.randn(1, 10, generator=torch.Generator().manual_seed(2))
    pose = dataclasses.replace(pose, expression=psi)
    assert torch.allclose(avatar(pose).means, body(pose, shape).vertices[0], atol=1e-5)
    neutral = dataclasses.replace(pose, expression=torch.zeros(1, 10))
    assert (avatar(pose).means - avatar(neutral).means).norm(dim=1).mean() > 0.005
    stiff = copy.deepcopy(body)
    stiff.frame_directions[: len(stiff.pose_features)] = 0
    assert (
        avatar(pose).means - seed_avatar(stiff, shape, None, PLAIN)(pose).means
    ).abs().max() > 0.005
