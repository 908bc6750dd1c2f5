"""What is known of poses without looking."""

import pytest
import torch

from gva_mi.body.pose import JOINTS, PARENTS, Shape
from gva_mi.pose.priors import FINGERS, LEAST, held_levers, joint_weights, levers


def test_weights_fall_along_every_limb():
    weights = joint_weights(PARENTS)
    assert float(weights[0]) == 1
    assert all(weights[j] < weights[p] for j, p in enumerate(PARENTS) if p >= 0)
    assert weights[JOINTS.index("left_index3")] < weights[JOINTS.index("left_elbow")]


def test_levers_shorten_along_every_limb(body):
    reach = dict(
        zip(
            JOINTS,
            levers(body.rest(Shape(torch.zeros(10))), body.weights, body.parents).tolist(),
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


def test_short_levers_hold_as_if_they_were_longer(body):
    far = levers(body.rest(Shape(torch.zeros(10))), body.weights, body.parents)
    held = dict(zip(JOINTS, held_levers(far).tolist(), strict=True))
    free = dict(zip(JOINTS, far.tolist(), strict=True))
    assert held["left_hip"] == free["left_hip"]
    assert held["left_foot"] == pytest.approx(LEAST) and free["left_foot"] < LEAST
    assert held["right_index1"] == pytest.approx(FINGERS)
