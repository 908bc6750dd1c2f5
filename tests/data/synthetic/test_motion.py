"""What the subjects' motions promise."""

from functools import cache

import numpy as np
import pytest
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.data.synthetic import motion

JOINT_POSITIONS = torch.tensor(np.random.default_rng(0).normal(0, 0.3, (55, 3))).float()


def turn(frames=48, seed=0):
    return motion.turn(motion.times(frames), 10, np.random.default_rng(seed))


def everyday(frames=80, seed=0):
    return motion.everyday(motion.times(frames), 10, np.random.default_rng(seed))


@cache
def rest_joints():
    return load_body().rest(Shape(torch.zeros(10))).joints.numpy()


def on_foot(name, frames=240, seed=0):
    """A motion whose feet know where the ground is, and its joints in the world (T, 55, 3)."""
    joints = torch.from_numpy(rest_joints())
    rng = np.random.default_rng(seed)
    pose = motion.perform(name, motion.times(frames), rest_joints(), 10, rng)
    T = joint_transforms(pose.rotations, joints, PARENTS, pose.transl)
    return pose, ((T[..., :3, :3] @ joints[..., None])[..., 0] + T[..., :3, 3]).numpy()


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
        return motion.perform(name, t, rest_joints(), 10, np.random.default_rng(5))

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


BALLS = [JOINTS.index(f"{side}_foot") for side in ("left", "right")]


@pytest.mark.parametrize("name", ["still", "half", "walk", "sit", "dance"])
@pytest.mark.parametrize("seed", [0, 2])
def test_a_foot_that_carries_does_not_slide(name, seed):
    _, places = on_foot(name, seed=seed)
    ground = places[:, BALLS, 1].min()
    carries = places[:, BALLS, 1] < ground + 0.0005  # metres
    assert carries.mean() > 0.4
    assert carries.any(1).mean() > 0.9  # one of them nearly always does: nobody runs
    for k in range(2):
        stands = np.split(places[:, BALLS[k]], np.flatnonzero(np.diff(carries[:, k])) + 1)
        for stand, on in zip(stands, carries[np.r_[0, np.cumsum([len(s) for s in stands])[:-1]], k],
                             strict=True):  # fmt: skip
            if on:
                assert np.ptp(stand[:, [0, 2]], axis=0).max() < 0.01


@pytest.mark.parametrize("name", ["still", "half", "walk", "sit", "dance"])
def test_legs_reach_the_ground_and_knees_bend_forward(name):
    pose, places = on_foot(name)
    knees = pose.rotations[:, [JOINTS.index(f"{s}_knee") for s in ("left", "right")]]
    assert (knees[..., 0] > 0).all() and knees.norm(dim=-1).max() < 2.3  # radians
    assert places[:, BALLS, 1].min(1).max() < places[:, BALLS, 1].min() + 0.002


def test_who_stands_still_does_not_turn():
    for seed in range(5):
        pose, places = on_foot("still", seed=seed)
        assert np.abs(np.degrees(facing(pose))).max() < 15
        assert np.ptp(places[:, 0, [0, 2]], axis=0).max() < 0.15  # metres, the pelvis
        assert np.ptp(places[:, JOINTS.index("left_wrist")], axis=0).max() > 0.2  # but gestures


def test_half_a_turn_and_back():
    yaw = np.degrees(np.unwrap(facing(on_foot("half")[0])))
    assert 170 < np.ptp(yaw) < 190 and abs(yaw[-1] - yaw[0]) < 2


def test_who_walks_goes_some_metres_and_looks_ahead():
    for seed in range(4):
        pose, places = on_foot("walk", seed=seed)
        pelvis = places[:, 0]
        steps = np.diff(pelvis[:, [0, 2]], axis=0)
        assert np.linalg.norm(steps, axis=1).sum() > 4  # metres
        assert (np.ptp(pelvis[:, [0, 2]], axis=0) > 1.2).all()  # across the view, and toward it
        ahead = np.arctan2(steps[:, 0], steps[:, 1])
        away = np.angle(np.exp(1j * (ahead - facing(pose)[:-1])))
        assert np.abs(np.degrees(away)).max() < 20


def test_who_sits_comes_down_to_the_height_of_a_chair_and_gets_up_again():
    pelvis = on_foot("sit")[1][:, 0, 1] - on_foot("sit")[1][:, BALLS, 1].min()
    assert pelvis.max() > 0.9 and pelvis.min() < 0.7  # metres
    assert abs(pelvis[0] - pelvis[-1]) < 0.01


def test_who_dances_is_fast():
    seconds = 6.0 / 240
    hands = [JOINTS.index(f"{side}_wrist") for side in ("left", "right")]
    speed = {
        name: np.linalg.norm(np.diff(on_foot(name)[1][:, hands], axis=0), axis=-1).mean() / seconds
        for name in ("dance", "walk", "still")
    }
    assert speed["dance"] > 1.5 * speed["walk"] > 1.5 * speed["still"]


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
