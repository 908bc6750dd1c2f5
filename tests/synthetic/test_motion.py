"""Motions of subjects: periodic, smooth, with feet that do not slide."""

from functools import cache

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.synthetic.motion import motions
from gva_mi.synthetic.motion.actions import TOUCHING


def video_of(name, frames):
    return motions.perform(name, motions.times(frames), None, 10, np.random.default_rng(0))


@cache
def rest_joints():
    return load_body().rest(Shape(torch.zeros(10))).joints.numpy()


def on_foot(name, frames=240, seed=0):
    """Return a motion with feet on the ground, and its joints in the world (T, 55, 3)."""
    joints = torch.from_numpy(rest_joints())
    rng = np.random.default_rng(seed)
    pose = motions.perform(name, motions.times(frames), rest_joints(), 10, rng)
    T = joint_transforms(pose.rotations, joints, PARENTS, pose.transl)
    return pose, ((T[..., :3, :3] @ joints[..., None])[..., 0] + T[..., :3, 3]).numpy()


def facing(pose: Pose) -> np.ndarray:
    """Return the yaw of the pelvis, radians, (T,)."""
    forward = roma.rotvec_to_rotmat(pose.rotations[:, 0])[..., 2].numpy()
    return np.arctan2(forward[:, 0], forward[:, 2])


def test_the_video_is_one_full_turn_at_constant_speed():
    steps = np.diff(np.unwrap(facing(video_of("turn", 48))))
    assert np.allclose(steps, steps[0], atol=0.03)
    assert np.isclose(abs(steps.sum()) + abs(steps.mean()), 2 * np.pi, atol=0.05)


@pytest.mark.parametrize("name", [*motions.ON_TURNTABLE, "everyday", *motions.ON_FOOT])
def test_a_motion_is_a_function_of_time_and_periodic(name):
    def at(t):
        return motions.perform(name, t, rest_joints(), 10, np.random.default_rng(5))

    t = motions.times(12)
    whole, part, round_on = at(t), at(t[3:5]), at(t + 1)
    assert torch.equal(whole.rotations[3:5], part.rotations)
    assert torch.equal(whole.expression[3:5], part.expression)
    assert torch.allclose(whole.rotations[:, 1:], round_on.rotations[:, 1:], atol=1e-5)


@pytest.mark.parametrize("posture", TOUCHING)
def test_hands_stay_at_the_trunk_when_parts_touch(posture, monkeypatch):
    """Wrists are within a forearm of the trunk's axis in all frames, and the turn is the same."""
    monkeypatch.setattr("gva_mi.synthetic.motion.actions.TOUCHING", {posture: TOUCHING[posture]})
    pose = video_of("touch", 24)
    joints = torch.from_numpy(rest_joints())
    T = joint_transforms(pose.rotations, joints, PARENTS, pose.transl)
    at = ((T[..., :3, :3] @ joints[..., None])[..., 0] + T[..., :3, 3]).numpy()
    wrists = at[:, [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]]
    aside = np.linalg.norm((wrists - at[:, :1])[..., [0, 2]], axis=2)
    assert aside.max() < 0.36
    assert np.allclose(facing(pose), facing(video_of("turn", 24)))


BALLS = [JOINTS.index(f"{side}_foot") for side in ("left", "right")]


@pytest.mark.parametrize("name", ["still", "half", "walk", "dance"])
def test_a_standing_foot_does_not_slide_and_knees_bend_forward(name):
    pose, places = on_foot(name)
    knees = pose.rotations[:, [JOINTS.index(f"{s}_knee") for s in ("left", "right")]]
    assert (knees[..., 0] > 0).all() and knees.norm(dim=-1).max() < 2.3  # radians
    ground = places[:, BALLS, 1].min()
    assert places[:, BALLS, 1].min(1).max() < ground + 0.002
    loaded = places[:, BALLS, 1] < ground + 0.0005  # metres
    assert loaded.mean() > 0.4
    assert loaded.any(1).mean() > 0.9
    for k in range(2):
        stands = np.split(places[:, BALLS[k]], np.flatnonzero(np.diff(loaded[:, k])) + 1)
        for stand, on in zip(stands, loaded[np.r_[0, np.cumsum([len(s) for s in stands])[:-1]], k],
                             strict=True):  # fmt: skip
            if on:
                assert np.ptp(stand[:, [0, 2]], axis=0).max() < 0.01


def test_walking_covers_some_metres_and_faces_ahead():
    pose, places = on_foot("walk")
    steps = np.diff(places[:, 0, [0, 2]], axis=0)  # of the pelvis
    assert np.linalg.norm(steps, axis=1).sum() > 4  # metres
    ahead = np.arctan2(steps[:, 0], steps[:, 1])
    away = np.angle(np.exp(1j * (ahead - facing(pose)[:-1])))
    assert np.abs(np.degrees(away)).max() < 20


@pytest.mark.parametrize("name", ["turn", "everyday"])
def test_novel_poses_are_not_in_the_video(name):
    video = video_of(name, 80).rotations[:, 1:22]
    for pose in motions.novel(10, 10, np.random.default_rng(0)).rotations[:, 1:22]:
        nearest = (video - pose).norm(dim=-1).amax(dim=1).min()
        assert nearest > 0.2  # radians, for at least one joint of the body
