"""What the subjects' motions promise."""

import numpy as np
import pytest
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.data.synthetic import motion

JOINT_POSITIONS = torch.tensor(np.random.default_rng(0).normal(0, 0.3, (55, 3))).float()


def turn(frames=48, seed=0):
    return motion.turn(motion.times(frames), 10, np.random.default_rng(seed))


def everyday(frames=80, seed=0):
    return motion.everyday(motion.times(frames), 10, np.random.default_rng(seed))


def facing(pose: Pose) -> np.ndarray:
    """The angle about the vertical to which the pelvis faces, radians, (T,)."""
    T = joint_transforms(pose.rotations, JOINT_POSITIONS, PARENTS, pose.transl)
    forward = T[:, 0, :3, 2].numpy()
    return np.arctan2(forward[:, 0], forward[:, 2])


def test_the_video_is_one_full_turn_at_an_even_pace():
    steps = np.diff(np.unwrap(facing(turn(48))))
    assert np.allclose(steps, steps[0], atol=0.03)
    assert np.isclose(abs(steps.sum()) + abs(steps.mean()), 2 * np.pi, atol=0.05)


def test_joints_move_smoothly():
    jumps = turn(80).rotations[:, 1:].diff(dim=0).abs().amax()
    assert jumps < 0.5  # radians a frame, for the fastest finger


def test_hands_open_and_close():
    curl = turn(80).rotations[:, JOINTS.index("left_index2"), 2]
    assert curl.max() - curl.min() > 0.5


def test_same_seed_same_motion_and_another_seed_another():
    assert torch.equal(turn(seed=3).rotations, turn(seed=3).rotations)
    assert not torch.allclose(turn(seed=3).rotations, turn(seed=4).rotations)


@pytest.mark.parametrize("name", motion.MOTIONS)
def test_a_motion_is_a_function_of_time_and_periodic(name):
    def at(t):
        return motion.MOTIONS[name](t, 10, np.random.default_rng(5))

    t = motion.times(12)
    whole, part, round_on = at(t), at(t[3:5]), at(t + 1)
    assert torch.equal(whole.rotations[3:5], part.rotations)
    assert torch.equal(whole.expression[3:5], part.expression)
    assert torch.allclose(whole.rotations[:, 1:], round_on.rotations[:, 1:], atol=1e-5)


def test_steps_back_in_time_are_where_the_motion_was():
    t = motion.times(150)  # frames as far apart as steps
    assert np.allclose(motion.before(t, 3)[3:], t[:-3])


def test_the_everyday_video_squats_steps_and_brings_the_hands_together():
    pose = everyday()
    knees = pose.rotations[:, [JOINTS.index(f"{s}_knee") for s in ("left", "right")], 0]
    elbows = pose.rotations[:, [JOINTS.index(f"{s}_elbow") for s in ("left", "right")], 1].abs()
    assert knees.min(1).values.max() > 0.8 and elbows.min(1).values.max() > 0.8
    assert (knees[:, 0] - knees[:, 1]).abs().max() > 0.08
    assert pose.rotations[:, 1:].diff(dim=0).abs().amax() < 0.6


def test_the_face_moves():
    pose = turn(60)
    opened = pose.rotations[:, JOINTS.index("jaw"), 0]
    assert opened.max() > 0.03 and opened.min() >= 0
    assert pose.expression.std(0).min() > 0.02 and pose.expression.abs().max() < 3


@pytest.mark.parametrize("video", [turn, everyday])
def test_novel_poses_are_not_in_the_video(video):
    video = video(80).rotations[:, 1:22]
    for pose in motion.novel(10, 10, np.random.default_rng(0)).rotations[:, 1:22]:
        nearest = (video - pose).norm(dim=-1).amax(dim=1).min()
        assert nearest > 0.2  # radians, for at least one joint of the body
