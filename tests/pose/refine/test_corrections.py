"""Corrections start at the MAP estimate, and the error model is inferred from them."""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JAW_AND_EYES, JOINTS, PARENTS, Pose
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.camera_tilt import TiltPrior
from gva_mi.prior.error_model import DEFAULT_FPS, GROUPS, stage1_errors
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.corrections import Corrections

ELBOW = JOINTS.index("left_elbow")


@pytest.fixture
def make(camera, body):
    anatomy = Anatomy.of(body.j_template)

    def corrections(pose, frames=None):
        frames = range(len(pose)) if frames is None else frames
        return Corrections.map_estimate(Stage1Poses.of(pose, frames, camera), anatomy)

    return corrections


@pytest.fixture
def with_turns(camera, body):
    """Corrections of a pose by given turns (n, J, 3), under the prior of stage 1."""
    anatomy = Anatomy.of(body.j_template)

    def corrections(pose, turns, known=None):
        stage1 = Stage1Poses.of(pose, range(len(pose)), camera)
        prior = Corrections.map_estimate(stage1, anatomy, known).prior
        return Corrections(stage1, anatomy, prior, turns, torch.zeros(len(pose), 3))

    return corrections


def turning_round(frames, rounds):
    """A person at rest who turns about the vertical."""
    pose = Pose.rest(frames)
    pose.rotations[:, 0] = 0
    pose.rotations[:, 0, 1] = 2 * torch.pi * rounds * torch.arange(frames) / frames
    return pose


def same_turn(frames, joint):
    """Turns of 0.05 rad toward the camera in all frames."""
    turns = torch.zeros(frames, len(JOINTS), 3)
    turns[:, JOINTS.index(joint), 0] = 0.05
    return turns


def matrices(pose):
    return roma.rotvec_to_rotmat(pose.rotations.detach())


def test_turns_and_shifts_are_in_the_axes_of_the_camera(make, camera, true_pose):
    """A turn about the line of sight turns the limb in the image, wherever it points."""
    corrections, sight = make(true_pose, frames=[0]), torch.tensor(camera.T_camera_world[2, :3])
    before, joints = corrections.pose([0]), torch.zeros(1, 55, 3)
    with torch.no_grad():
        corrections.turns[:, ELBOW, 2] = 0.25
        corrections.moves[:, 2] = 0.25
    after = corrections.pose([0])
    G = [
        turn_joints(pose.rotations.detach(), joints, PARENTS, torch.zeros(1, 3))[1]
        for pose in (before, after)
    ]
    turned = roma.rotmat_to_rotvec(G[1][:, ELBOW, :3, :3] @ G[0][:, ELBOW, :3, :3].mT)[0]
    assert float(turned.norm()) > 0.1
    torch.testing.assert_close(turned / turned.norm(), sight.float(), atol=1e-4, rtol=0)
    moved = (after.transl - before.transl).detach()[0]
    torch.testing.assert_close(moved / moved.norm(), sight.float(), atol=1e-5, rtol=0)


def test_a_tilt_of_the_person_costs_in_every_frame_and_one_of_a_limb_once(with_turns):
    """Clothes would tilt the person a little in every image."""
    nats = lambda joint, n: float(with_turns(Pose.rest(n), same_turn(n, joint)).energy().detach())
    few, many = 8, 64
    assert nats("pelvis", many) > 0.9 * nats("pelvis", few) > 0.1
    assert nats("left_hip", many) < 0.3 * nats("left_hip", few)


@pytest.mark.parametrize("rounds", [1.0, 0.0])
def test_constant_turns_cost_in_each_frame_if_the_person_turns(with_turns, rounds):
    """A swing to both sides costs nothing."""
    costs = []
    for frames in (8, 64):
        pose, turns = turning_round(frames, rounds), same_turn(frames, "left_hip")
        swing = turns * torch.tensor([1.0, -1.0]).repeat(frames // 2)[:, None, None]
        costly = [with_turns(pose, x).constant_turn_energy() for x in (turns, swing)]
        same, none = (float(energy.detach()) for energy in costly)
        assert none < 1e-9
        costs.append(same)
    assert costs[1] > 0.9 * costs[0] > 0.1 if rounds else max(costs) < 1e-6


def test_constant_turns_of_a_known_estimator_are_held_from_first_to_last(with_turns, monkeypatch):
    """They cost ``constant_turn_energy``; an inferred one has the camera-locked tilt instead."""
    pose, turns = turning_round(64, 1.0), same_turn(64, "left_hip")
    for errors in (None, stage1_errors(DEFAULT_FPS)):
        held = with_turns(pose, turns, errors)
        with torch.no_grad():
            energy, constant = held.energy(), held.constant_turn_energy()
            monkeypatch.setattr(TiltPrior, "energy", lambda *_: 0)
            monkeypatch.setattr(Corrections, "constant_turn_energy", lambda _: 0)
            cost = energy - held.energy()
            monkeypatch.undo()
        assert constant > 0.1
        assert (abs(cost - constant) < 1e-3) == (errors is not None)


def test_the_error_model_is_inferred_from_corrections(make):
    """Errors of 0.2 rad that last for about six frames, at the elbows alone."""
    from scipy.ndimage import gaussian_filter1d

    rng, frames = np.random.default_rng(0), 120
    errors = gaussian_filter1d(rng.normal(size=(frames + 40, 2, 3)), 6.0, axis=0)[20:-20]
    errors = torch.from_numpy(0.2 * errors / errors.std()).float()
    corrections = make(Pose.rest(frames))
    with torch.no_grad():
        corrections.start[0][:, list(GROUPS["elbows"])] = -errors
    updated = corrections.with_updated_prior(*corrections.found())
    noise = updated.prior.error_models
    assert noise["elbows"].slow == pytest.approx(0.2, rel=0.4)
    assert 3 <= noise["elbows"].memory <= 12
    assert noise["knees"].slow < 0.5 * noise["elbows"].slow
    before, after = (c.pose(range(frames)) for c in (corrections, updated))
    torch.testing.assert_close(matrices(after), matrices(before))


def test_the_video_solvers_errors_last_as_many_seconds_at_any_frame_rate():
    usual, slower = stage1_errors(DEFAULT_FPS), stage1_errors(DEFAULT_FPS / 2)
    for name, noise in usual.items():
        assert (2 * slower[name].memory, 2 * slower[name].lag) == (noise.memory, noise.lag)
        assert (slower[name].slow, slower[name].bias) == (noise.slow, noise.bias)


def turning(frames=12):
    """A person who turns by 30 degrees a frame, tilted."""
    pose = Pose.rest(frames)
    around = torch.zeros(frames, 3)
    around[:, 1] = torch.arange(frames) * np.pi / 6
    tilt = torch.tensor([0.2, 0.0, 0.1]).expand(frames, 3)
    pose.rotations[:, 0] = roma.rotvec_composition([around, tilt])
    return pose


@pytest.mark.parametrize("axes", ["camera", "body"])
def test_centring_removes_what_another_shape_would_show(make, axes):
    corrections = make(turning())
    stage1, before = corrections._stage1, corrections.pose(range(12))
    turns = torch.tensor([0.1, -0.2, 0.05]).expand(corrections.start[0].shape)
    shift = torch.tensor([0.01, 0.02, -0.03])
    R_camera_body = stage1.R_joint_camera[:, 0].mT
    moves = shift.expand(12, 3) if axes == "camera" else R_camera_body @ shift
    turns0, moves0 = corrections.start
    corrections.start = turns0 + stage1.to_camera_axes(turns), moves0 + moves
    corrections.centre()
    after = corrections.pose(range(12))
    torch.testing.assert_close(after.transl, before.transl, atol=1e-6, rtol=0)
    torch.testing.assert_close(matrices(after), matrices(before), atol=1e-5, rtol=0)


def test_the_distance_that_all_frames_share_is_kept(make, true_pose):
    corrections = make(true_pose)
    with torch.no_grad():
        corrections.turns += 0.1
        shifts = torch.linspace(0.1, 0.3, corrections.moves.numel())
        corrections.moves += shifts.view_as(corrections.moves)
    turns, moves = corrections.found()
    assert moves[:, 2].mean().abs() > 0.01
    corrections.keep_distance()
    turns_after, moves_after = corrections.found()
    torch.testing.assert_close(turns_after, turns)
    torch.testing.assert_close(moves_after[:, :2], moves[:, :2])
    torch.testing.assert_close(moves_after[:, 2], moves[:, 2] - moves[:, 2].mean())


def test_the_face_stays(make, true_pose):
    corrections = make(true_pose)
    with torch.no_grad():
        corrections.turns += 0.5
    found = corrections.pose(range(len(true_pose))).rotations[:, JAW_AND_EYES].detach()
    torch.testing.assert_close(found, true_pose.rotations[:, JAW_AND_EYES])
