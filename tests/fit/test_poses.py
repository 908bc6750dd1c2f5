"""Trained poses come closer to ground truth; poses without evidence stay."""

from dataclasses import replace
from itertools import count

import pytest
import torch

from gva_mi.body.pose import JOINTS, WRISTS, Pose
from gva_mi.body.so3 import turns_between
from gva_mi.fit.poses import PoseOptions, TrainedPoses

STEPS = 300
OPTIONS = PoseOptions(every=3)
JAW, EYES = JOINTS.index("jaw"), [i for i, name in enumerate(JOINTS) if "eye" in name]
ELBOW = JOINTS.index("left_elbow")
TEST = 4  # is not looked at
FRAMES = 9


@pytest.fixture
def truth(turning):
    return turning(FRAMES)[0]


def off(pose, shifts):
    """Shifted by (T, 3), metres."""
    return Pose(pose.rotations, pose.transl + torch.as_tensor(shifts), pose.expression)


def lasting(x=0.04):
    """A slow error, first upward and then downward. (A sideways one would be constant in the axes
    of the turning person, and stay.)"""
    angle = 2 * torch.pi * torch.arange(FRAMES) / FRAMES
    return torch.stack([0 * angle, x * angle.sin(), 0 * angle], dim=1)


def trained_to(truth, given, known, camera, options=OPTIONS, until=STEPS, poses=None, since=0,
    tests=(TEST,), faces=False):  # fmt: skip
    """Descend on the distance to the ground-truth place and elbow, and optionally face, frame by
    frame except for ``tests``."""
    poses = poses or TrainedPoses(given, [camera] * len(given), known.rig, options, STEPS)
    order = [k for k in range(len(given)) if k not in tests]
    for step in range(since, until):
        poses.expect(order[k % len(order)] for k in count(step))
        frame = order[step % len(order)]
        pose = poses(frame)
        loss = (pose.transl - truth.transl[frame]).abs().mean()
        loss = loss + (pose.rotations[:, ELBOW] - truth.rotations[frame, ELBOW]).abs().mean()
        if faces:
            loss = loss + (pose.rotations[:, JAW] - truth.rotations[frame, JAW]).abs().mean()
            loss = loss + 0.1 * (pose.expression - truth.expression[frame]).abs().mean()
        if loss.requires_grad:
            loss.backward()
        poses.step(step + 1)
    return poses


@pytest.mark.parametrize("wrists", [True, False])
def test_hands_turn_at_the_wrist_unless_they_may_not(wrists, truth, known, camera):
    options = replace(OPTIONS, wrists=wrists)
    poses = TrainedPoses(truth, [camera] * FRAMES, known.rig, options, STEPS, as_given=True)
    for step in range(30):
        (poses(step % FRAMES).rotations[0, [ELBOW, *WRISTS]] - 1).abs().sum().backward()
        poses.step(step + 1)
    moved = (poses.all().rotations - truth.rotations).norm(dim=2).amax(0)
    assert moved[ELBOW] > 0.01
    assert (moved[WRISTS] > 0.01).all() if wrists else (moved[WRISTS] == 0).all()


def test_frames_that_are_posed_together_are_posed_as_one_by_one(truth, known, camera):
    given = TrainedPoses(truth, [camera] * FRAMES, known.rig, replace(OPTIONS, every=5), STEPS)
    alone = [given(k) for k in range(5)]
    given.step(5)
    given.expect(iter(range(5)))
    together = [given(k) for k in range(5)]
    for a, b in zip(alone, together, strict=True):
        torch.testing.assert_close(a.rotations, b.rotations)
        torch.testing.assert_close(a.transl, b.transl)


def test_gradients_of_skeletons_train_poses_as_those_of_poses_do(truth, known, camera):
    trained = []
    for skeletons in (False, True):
        derived = {"derived": known.posed_skeleton} if skeletons else {}
        poses = TrainedPoses(truth, [camera] * FRAMES, known.rig, OPTIONS, STEPS, **derived)
        for k in range(OPTIONS.every):
            skeleton = poses(k) if skeletons else known.posed_skeleton(poses(k))
            (skeleton.T_world_rest[..., :3, 3] - 0.1).square().sum().backward()
        poses.step(OPTIONS.every)
        trained.append(poses.all())
    torch.testing.assert_close(trained[0].rotations, trained[1].rotations)
    assert (trained[0].rotations - truth.rotations).abs().max() > 1e-3


def away(pose, truth):
    """(T,) metres."""
    return (pose.transl - truth.transl).norm(dim=1)


def rms(pose, truth, frames):
    return float((pose.transl - truth.transl)[frames].square().sum(1).mean().sqrt())


def test_poses_come_to_ground_truth_and_unseen_frames_follow(truth, known, camera):
    given = off(truth, lasting())
    found = trained_to(truth, given, known, camera).all()
    before, after = away(given, truth), away(found, truth)
    assert after.mean() < 0.5 * before.mean() and after[TEST] < before[TEST]
    torch.testing.assert_close(found.transl.mean(0), truth.transl.mean(0), rtol=0, atol=1e-5)
    # Nothing was estimated of the face: it stays as it is.
    face = [JAW, *EYES]
    assert torch.equal(found.rotations[:, face], truth.rotations[:, face])
    assert torch.equal(found.expression, truth.expression)


@pytest.mark.parametrize("constant", [True, False])
def test_a_bend_in_all_frames_is_mended_only_if_constant_corrections_are_kept(
    constant, truth, known, camera
):
    bend = torch.zeros_like(truth.rotations)
    bend[:, ELBOW, 1] = 0.2
    given = Pose(truth.rotations + bend, truth.transl, truth.expression)
    options = replace(OPTIONS, constant=constant)
    found = trained_to(truth, given, known, camera, options).all()
    left = turns_between(found.rotations, truth.rotations)[:, ELBOW].norm(dim=1)
    assert left.mean() < 0.12 if constant else left.mean() > 0.19


def test_refined_poses_start_as_given_and_stage_1_poses_smoothed(turning, known, camera):
    frames = 20
    truth, _ = turning(frames)
    errors = 0.02 * torch.randn(frames, 3, generator=torch.Generator().manual_seed(0))
    given = off(truth, errors)
    smoothed, refined = (
        TrainedPoses(given, [camera] * frames, known.rig, OPTIONS, STEPS, as_given=as_given).all()
        for as_given in (False, True)
    )
    torch.testing.assert_close(refined.transl, given.transl, rtol=0, atol=1e-6)
    assert turns_between(refined.rotations, given.rotations).norm(dim=-1).max() < 1e-5
    assert rms(smoothed, truth, range(frames)) < 0.8 * rms(given, truth, range(frames))


def talking(turning, frames, white=0.0, slow=0.0):
    """Someone who talks before the camera, and what an estimator says of it: (truth, given)."""
    truth, t = turning(frames)[0], torch.arange(frames) / frames
    rotations, expression = truth.rotations.clone(), truth.expression.clone()
    rotations[:, 0] = 0
    rotations[:, JAW, 0] = 0.1 + 0.1 * torch.sin(20 * t)
    expression[:, 0], expression[:, 1] = torch.sin(9 * t), 0.5 * torch.cos(7 * t)
    truth = Pose(rotations, truth.transl, expression)
    noise = torch.randn(frames, 5, generator=torch.Generator().manual_seed(1))
    errors = white * noise + slow * torch.sin(12 * t[:, None] + torch.arange(5))
    errors = errors - errors.mean(0)
    rotations, expression = rotations.clone(), expression.clone()
    rotations[:, JAW] += 0.1 * errors[:, 2:]
    expression[:, :2] += errors[:, :2]
    return truth, Pose(rotations, truth.transl, expression)


def faces_off(pose, truth, frames):
    """Of the jaw, radians, and of the expression, standard deviations: root mean squares."""
    jaw = (pose.rotations - truth.rotations)[frames, JAW].square().sum(1).mean().sqrt()
    return float(jaw), float((pose.expression - truth.expression)[frames].square().mean().sqrt())


def test_slow_errors_of_faces_are_corrected(turning, known, camera):
    truth, given = talking(turning, frames := 20, slow=0.3)
    options = replace(OPTIONS, every=1)
    found = trained_to(truth, given, known, camera, options, 300, tests=(), faces=True).all()
    before, after = (faces_off(pose, truth, range(frames)) for pose in (given, found))
    assert after[0] < 0.8 * before[0] and after[1] < 0.8 * before[1], (before, after)


def test_a_resumed_training_ends_with_the_same_bits(turning, known, camera):
    truth, given = talking(turning, FRAMES, white=0.3)
    given, cameras = off(given, lasting()), [camera] * FRAMES
    whole = trained_to(truth, given, known, camera, faces=True)
    kill = 200  # between steps of the poses, after the prior was fitted again
    killed = trained_to(truth, given, known, camera, until=kill, faces=True)
    resumed = TrainedPoses(given, cameras, known.rig, OPTIONS, STEPS)
    resumed.load_state(killed.state())
    resumed = trained_to(truth, given, known, camera, poses=resumed, since=kill, faces=True)
    assert torch.equal(resumed.all().expression, whole.all().expression)
    assert torch.equal(resumed.all().rotations, whole.all().rotations)
    assert torch.equal(resumed.all().transl, whole.all().transl)
