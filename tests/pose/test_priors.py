"""What is known of poses without looking."""

import torch
from gva_mi.pose.priors import (
    FACE,
    joint_weights,
    lever_arms,
    turn_rates,
)

from gva_mi.body.pose import JOINTS, PARENTS, Shape


def test_weights_fall_along_every_limb():
    weights = joint_weights(PARENTS)
    assert float(weights[0]) == 1
    assert all(weights[j] < weights[p] for j, p in enumerate(PARENTS) if p >= 0)
    assert weights[JOINTS.index("left_index3")] < weights[JOINTS.index("left_elbow")]


def test_lever_arms_shorten_along_every_limb(body):
    reach = dict(
        zip(
            JOINTS,
            lever_arms(body.rest(Shape(torch.zeros(10))), body.weights, body.parents).tolist(),
            strict=True,
        )
    )
    for side in ("left", "right"):
        arm = [
            reach[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist", "index1", "index3")
        ]
        leg = [reach[f"{side}_{name}"] for name in ("hip", "knee", "ankle")]
        assert arm == sorted(arm, reverse=True) and leg == sorted(leg, reverse=True)
    assert 0.3 < reach["left_shoulder"] < 0.8 and reach["left_index3"] < 0.05


def test_a_step_moves_the_surface_alike_at_every_joint_but_the_face():
    arms = torch.linspace(0.1, 1.0, len(JOINTS))
    rates = turn_rates(arms, step=0.01, largest_turn=0.05)[:, 0]
    assert not rates[FACE].any()
    rest = torch.ones(len(JOINTS), dtype=bool)
    rest[FACE] = False
    far = arms > 0.01 / 0.05
    torch.testing.assert_close((rates * arms)[rest & far], torch.full_like(arms, 0.01)[rest & far])
    assert (rates[rest & ~far] == 0.05).all()
