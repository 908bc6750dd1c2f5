"""Corrections are slow in time, and what is known of them without looking."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.pose import SequenceOptions
from gva_mi.pose.corrections import Corrections, robust

ELBOW = JOINTS.index("left_elbow")
LENGTH = 0.3
LENGTHS = torch.full((55,), LENGTH)
OPTIONS = SequenceOptions()


def turning(speed, frames=7, joint=ELBOW):
    """A pose in which one joint turns, by ``speed`` radians from frame to frame."""
    rotations = torch.zeros(frames, 55, 3)
    rotations[:, joint, 1] = speed * torch.arange(frames)
    return Pose(rotations, torch.zeros(frames, 3), torch.zeros(frames, 10))


@pytest.fixture
def make(camera):
    def corrections(pose, frames=None, **changes):
        frames = range(len(pose)) if frames is None else frames
        return Corrections(pose, frames, camera, LENGTHS, replace(OPTIONS, **changes))

    return corrections


def test_without_a_correction_the_pose_is_stage_1(make, true_pose):
    found = make(true_pose).pose([2, 0])
    expected = true_pose[[2, 0]]
    torch.testing.assert_close(
        roma.rotvec_to_rotmat(found.rotations), roma.rotvec_to_rotmat(expected.rotations)
    )
    assert torch.equal(found.transl, expected.transl)


def test_a_step_of_one_frame_moves_its_neighbours_less_and_less(make):
    corrections = make(turning(0.0))
    with torch.no_grad():
        corrections.turns[3, ELBOW, 0] = 1.0
    angle = corrections.pose(range(7)).rotations[:, ELBOW].norm(dim=1).detach()
    assert (angle > 0).all()
    torch.testing.assert_close(angle, angle.flip(0))
    assert (angle[:4].diff() > 0).all()
    assert float(angle.sum()) == pytest.approx(1, rel=1e-5)  # spread, not lost


def test_what_all_frames_share_passes_unchanged(make):
    corrections = make(turning(0.0))
    with torch.no_grad():
        corrections.turns[:, ELBOW, 0] = 0.3
    angle = corrections.pose(range(7)).rotations[:, ELBOW].norm(dim=1).detach()
    torch.testing.assert_close(angle, torch.full((7,), 0.3))


def test_frames_that_do_not_follow_each_other_do_not_pull(make):
    corrections = make(turning(0.0), frames=[0, 1, 4, 5])
    with torch.no_grad():
        corrections.turns[1, ELBOW, 0] = 1.0
    angle = corrections.pose(range(4)).rotations[:, ELBOW].norm(dim=1)
    assert angle[0] > 0 and angle[1] > 0 and not angle[2:].any()


def test_a_single_frame_has_no_neighbours(make):
    corrections = make(turning(0.5), frames=[2])
    assert float(corrections.energy().detach()) == 0
    assert float(corrections.pose([0]).rotations[0, ELBOW, 1].detach()) == pytest.approx(1.0)


def test_fast_motion_is_believed_and_jitter_is_not(make):
    """At stage 1 itself the energy is what lies within the jitter."""
    pulled = lambda speed: float(make(turning(speed), outlier=1.0).energy().detach())
    as_if_all = lambda speed: OPTIONS.smooth * (LENGTH * speed) ** 2 * 6 / 7
    assert pulled(0.0) == 0
    assert pulled(0.02) == pytest.approx(as_if_all(0.02), rel=0.01)
    assert pulled(0.5) < 0.01 * as_if_all(0.5)


def test_a_jump_costs_by_its_size_and_not_by_its_square():
    x, c = torch.tensor([1e-4, 0.1, 0.2, 1.0], dtype=torch.float64), 0.005
    cost = robust(x.square(), c)
    assert float(cost[0]) == pytest.approx(1e-8, rel=1e-3)
    assert float(cost[2] / cost[1]) == pytest.approx(2, rel=0.05)
    assert float(cost[3]) == pytest.approx(2 * c, rel=0.02)


def test_turns_are_in_the_axes_of_the_camera(make, camera, true_pose):
    """About the line of sight: what hangs on the joint turns in the picture, wherever it points."""
    corrections = make(true_pose)
    with torch.no_grad():
        corrections.turns[:, ELBOW, 2] = 0.25
    found, T = corrections.pose(range(len(true_pose))).rotations.detach(), len(true_pose)
    joints, origin = torch.zeros(1, 55, 3), torch.zeros(T, 3)
    G = [
        turn_joints(r, joints, PARENTS, origin)[1][:, ELBOW, :3, :3]
        for r in (true_pose.rotations, found)
    ]
    turned = roma.rotmat_to_rotvec(G[1] @ G[0].mT)
    sight = torch.tensor(camera.T_camera_world[2, :3]).float()
    torch.testing.assert_close(turned, 0.25 * sight.expand(T, 3), atol=1e-5, rtol=0)


def test_the_turn_of_the_whole_body_is_always_believed(make):
    assert float(make(turning(0.02, joint=0)).energy().detach()) == 0


def test_a_constant_correction_costs_by_the_prior_alone(make):
    corrections = make(turning(0.0))
    with torch.no_grad():
        corrections.turns[:, ELBOW, 2] = 0.1
        corrections.moves[:, 1] = 0.2
    expected = OPTIONS.prior * (LENGTH * 0.1) ** 2 + OPTIONS.hold * 0.04
    assert float(corrections.energy().detach()) == pytest.approx(expected, rel=1e-4)


def test_shifts_are_in_the_axes_of_the_camera(make, camera):
    corrections = make(turning(0.0))
    with torch.no_grad():
        corrections.moves[:, 2] = 0.25
    moved = corrections.pose([3]).transl[0].detach().numpy()
    np.testing.assert_allclose(moved, 0.25 * camera.T_camera_world[2, :3], atol=1e-6)


def test_gradient_matches_differences(make):
    corrections = make(turning(0.03))
    generator = torch.Generator().manual_seed(0)
    leaves = corrections.turns, corrections.moves
    with torch.no_grad():
        for leaf in leaves:
            leaf += 0.1 * torch.randn(leaf.shape, generator=generator)
    directions = [torch.randn(leaf.shape, generator=generator) for leaf in leaves]
    corrections.energy().backward()
    slope = sum(float((x.grad * d).sum()) for x, d in zip(leaves, directions, strict=True))

    def at(step):
        with torch.no_grad():
            for leaf, d in zip(leaves, directions, strict=True):
                leaf += step * d
            value = float(corrections.energy().detach())
            for leaf, d in zip(leaves, directions, strict=True):
                leaf -= step * d
        return value

    assert slope == pytest.approx((at(1e-2) - at(-1e-2)) / 2e-2, rel=1e-3)
