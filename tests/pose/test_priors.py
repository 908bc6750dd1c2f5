"""What is known of poses without looking."""

import roma
import torch

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.pose.priors import joint_weights, squared_angles


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
