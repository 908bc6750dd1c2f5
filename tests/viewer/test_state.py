"""Untouched values keep their bits, joints turn about their own axes, motions loop."""

import math

import roma
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.viewer.state import Playback, State, posed

KNEE = JOINTS.index("left_knee")


def test_an_untouched_state_has_the_bits_of_the_frame(motion):
    for k in range(len(motion)):
        pose = posed(motion, State(frame=k, turned=((KNEE, (0.0, 0.0, 0.0)),), expression=(0.0,)))
        assert torch.equal(pose.rotations, motion[k].rotations)
        assert torch.equal(pose.expression, motion[k].expression)
        assert torch.equal(pose.transl, motion[k].transl)


def test_only_the_turned_joint_moves_about_its_own_axes(motion):
    shoulder = JOINTS.index("left_shoulder")  # which the motion turns, too
    pose = posed(motion, State(frame=2, turned=((shoulder, (0.0, 30.0, 0.0)),)))
    before, after = (roma.rotvec_to_rotmat(x.rotations[0]) for x in (motion[2], pose))
    own = roma.rotvec_to_rotmat(torch.tensor([0, math.pi / 6, 0]))
    assert torch.allclose(after[shoulder], before[shoulder] @ own, atol=1e-6)
    others = [j for j in range(55) if j != shoulder]
    assert torch.equal(pose.rotations[:, others], motion[2].rotations[:, others])


def test_an_expression_is_added_and_may_be_longer(motion):
    few = motion.map(torch.clone)
    few.expression[:, 0] = 1.0
    added = (0.5, *[0.0] * 10, 2.0)  # 12, the motion has 10
    found = posed(few, State(expression=added)).expression
    assert found.shape == (1, 12) and found[0, 0] == 1.5 and found[0, 11] == 2.0


def test_a_motion_plays_by_the_clock():
    playback, seldom = Playback(), Playback()
    frame = other = 3
    for k in range(1, 101):
        frame = playback.advance(frame, 10 + k * 0.013, 30, 40)
    for k in (1, 100):
        other = seldom.advance(other, 10 + k * 0.013, 30, 40)
    assert frame == other == (3 + int(99 * 0.013 * 30)) % 40
