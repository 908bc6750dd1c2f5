"""What is known of poses without looking."""

import roma
import torch

from gva_mi.body.pose import JOINTS, PARENTS, Shape
from gva_mi.pose.priors import joint_weights, levers, squared_angles


def test_weights_fall_along_every_limb():
    weights = joint_weights(PARENTS)
    assert float(weights[0]) == 1
    assert all(weights[j] < weights[p] for j, p in enumerate(PARENTS) if p >= 0)
    assert weights[JOINTS.index("left_index3")] < weights[JOINTS.index("left_elbow")]


def test_small_differences_are_squared_angles():
    generator = torch.Generator().manual_seed(1)
    base = roma.rotvec_to_rotmat(torch.randn(20, 3, generator=generator))
    small = 0.02 * torch.randn(20, 3, generator=generator)
    turned = base @ roma.rotvec_to_rotmat(small)
    expected = small.square().sum(1)
    torch.testing.assert_close(squared_angles(base, turned), expected, rtol=1e-3, atol=1e-7)


def test_half_a_turn_is_no_gap():
    a, b = (roma.rotvec_to_rotmat(torch.tensor([0.0, x, 0.0])) for x in (3.13, -3.13))
    assert float(squared_angles(a, b)) < 1e-3


def test_levers_shorten_along_every_limb(body):
    reach = dict(zip(JOINTS, levers(body, Shape(torch.zeros(10))).tolist(), strict=True))
    for side in ("left", "right"):
        arm = [
            reach[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist", "index1", "index3")
        ]
        leg = [reach[f"{side}_{name}"] for name in ("hip", "knee", "ankle")]
        assert arm == sorted(arm, reverse=True) and leg == sorted(leg, reverse=True)
    assert 0.3 < reach["left_shoulder"] < 0.8 and reach["left_index3"] < 0.05
