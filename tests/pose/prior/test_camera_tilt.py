"""Tilts of limbs that are locked to the camera cost, and other motions do not."""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.prior.camera_tilt import TILTING_JOINTS, TiltPrior
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.splat import Camera, look_at

N = 48
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)
KNEE = JOINTS.index("left_knee")
DEPTH, SIDEWAYS = torch.eye(3)[[0, 2]]  # axes of the camera, about which a limb turns


def turning(rounds=1.0):
    """A person who turns round, with bent limbs that move in other rhythms than the turn."""
    generator, pose = torch.Generator().manual_seed(0), Pose.rest(N)
    bent = 0.3 * torch.randn(1, 21, 3, generator=generator)
    phase = torch.rand(1, 21, 3, generator=generator)
    t = torch.arange(N)[:, None, None] / N
    sways = 0.1 * torch.sin(2 * torch.pi * (3 * t + phase))
    pose.rotations[:, TILTING_JOINTS] = roma.rotvec_composition([bent.expand(N, 21, 3), sways])
    pose.rotations[:, 0, 1] = 2 * torch.pi * rounds * torch.arange(N) / N
    return pose


def leaning(pose, angle, axis=DEPTH, joint=KNEE):
    """The pose with a joint turned about an axis of the camera, alike in every frame."""
    n = len(pose)
    stage1 = Stage1Poses.of(pose, range(n), CAMERA)
    turns = torch.zeros(n, len(JOINTS), 3)
    turns[:, joint] = angle * axis
    return stage1.corrected(range(n), turns, torch.zeros(n, 3))


def tilt_of(pose, camera=CAMERA):
    return TiltPrior.of(Stage1Poses.of(pose, range(len(pose)), camera), pose.rotations)


def nats(tilt, pose):
    return float(tilt.energy(pose.rotations, pose.transl, torch.arange(len(pose))))


@pytest.mark.parametrize("axis", [DEPTH, SIDEWAYS], ids=["in depth", "sideways"])
def test_the_locked_part_is_the_angle_that_a_joint_tilts_by(axis):
    pose, angle = turning(), np.radians(4)
    tilt = tilt_of(pose)
    before, after = (
        tilt._locked(tilt._turns(p.rotations))[KNEE - 1] for p in (pose, leaning(pose, angle, axis))
    )
    assert torch.allclose(after - before, angle * axis, atol=0.1 * angle)


def test_a_tilt_in_depth_costs_but_not_other_motions_or_a_tilt_in_the_image():
    pose = turning()
    cost = lambda other: nats(tilt_of(pose), other)
    tilted = cost(leaning(pose, np.radians(4)))
    assert cost(pose) < 0.1 and tilted > 1
    assert cost(leaning(pose, np.radians(4), SIDEWAYS)) < 0.1 * tilted


def test_the_chance_level_follows_what_images_show_sideways():
    pose = turning()
    for joint in range(1, 22, 2):
        pose = leaning(pose, np.radians(4), SIDEWAYS, joint)
    assert nats(tilt_of(pose), leaning(pose, np.radians(4))) < 0.5
    assert nats(tilt_of(pose), pose) == 0  # below the level nothing costs


def test_twice_the_frames_do_not_weigh_more():
    once, n = turning(), []
    again = Pose(*(torch.cat([x, x]) for x in (once.rotations, once.transl, once.expression)))
    n = [nats(tilt_of(pose), leaning(pose, np.radians(4))) for pose in (once, again)]
    assert n[1] == pytest.approx(n[0], rel=1e-3)


@pytest.mark.parametrize("rounds", [0.0, 0.4])
def test_below_half_a_turn_the_term_is_off(rounds):
    pose = turning(rounds)
    assert nats(tilt_of(pose), leaning(pose, np.radians(6))) == 0
