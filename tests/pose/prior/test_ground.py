"""Standing feet share a plane and stay; swinging feet, and a turntable, are free."""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.prior.ground import Ground, Soles
from gva_mi.synthetic.motion.motions import perform, times

MEAN = Shape(torch.zeros(10))
FRAMES = 48
TIMES = torch.arange(FRAMES)
CAMERA = torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # looks along -z, y downward
HEELS, BALLS = slice(0, 2), slice(2, 4)


@pytest.fixture(scope="module")
def soles(body):
    return Soles.of(body.rest(MEAN), body.weights)


@pytest.fixture(scope="module")
def moving(body):
    """Poses of a synthetic motion."""
    joints = body.rest(MEAN).joints.numpy()
    return lambda motion, n=FRAMES: perform(motion, times(n), joints, 10, np.random.default_rng(5))


def under(soles, pose, R_camera_world=CAMERA):
    return Ground.under(soles, pose, torch.arange(len(pose)), R_camera_world)


def nats(soles, pose, ground=None):
    ground, n = ground or under(soles, pose), len(pose)
    return float(ground.energy(pose.rotations, pose.transl, torch.arange(n))) / n


def turned(pose, joint, axis, degrees):
    """The pose with a joint turned in all frames."""
    rotations = pose.rotations.clone()
    turn = torch.zeros(len(pose), 3)
    turn[:, axis] = torch.deg2rad(torch.as_tensor(degrees, dtype=torch.float32))
    at = JOINTS.index(joint)
    rotations[:, at] = roma.rotvec_composition([rotations[:, at], turn])
    return Pose(rotations, pose.transl, pose.expression)


def test_points_touch_the_ground_and_move_with_the_feet(soles, body, moving):
    assert soles.points[:, 1].max() - body.rest(MEAN).vertices[:, 1].min() < 0.006
    assert soles.points[BALLS, 2].min() > soles.points[HEELS, 2].max() + 0.08
    pose = moving("walk")
    places = soles.places(pose.rotations, pose.transl)
    maps = body(pose, MEAN).T_world_rest
    for q, name in enumerate(("left_ankle", "right_ankle", "left_foot", "right_foot")):
        T = maps[:, JOINTS.index(name)]
        expected = (T[:, :3, :3] @ soles.points[q]) + T[:, :3, 3]
        torch.testing.assert_close(places[:, q], expected, atol=1e-6, rtol=0)


def test_standing_and_swinging_are_told_apart(soles, moving):
    pose = moving("walk")
    ground = under(soles, pose)
    places = soles.places(pose.rotations, pose.transl)
    height, stands = ground.heights(places), ground.stands(places)
    still = places[1:-1].sub(places[:-2]).norm(dim=-1) < 1e-3
    assert 0.2 < still.float().mean() < 0.7
    assert stands[1:-1][still].min() > 0.8 and height[1:-1][still].abs().max() < 0.005
    assert stands[height > 0.04].max() < 0.2
    assert ground.contact.spread < 0.006 and 0.3 < ground.contact.share < 0.9


def test_a_foot_that_tips_for_a_while_is_turned_back(soles, moving):
    """The minimum is at the true turn of the ankle, and all pulls point there."""
    pose, at = moving("still"), JOINTS.index("left_ankle")
    while_ = 1.0 * ((TIMES > 10) & (TIMES < 24))[:, None]
    for axis in (0, 2):
        tipped = lambda d, axis=axis: turned(pose, "left_ankle", axis, (d * while_)[:, 0])
        ground = under(soles, tipped(6.0))
        degrees = torch.linspace(-8, 8, 17)
        costs = [nats(soles, tipped(d), ground) for d in degrees]
        assert abs(float(degrees[int(np.argmin(costs))])) <= 1
        rotations = tipped(3.0).rotations.clone().requires_grad_()
        ground.energy(rotations, pose.transl, TIMES).backward()
        pull = rotations.grad[11:24, at, axis]
        # At both ends a slower tip costs less.
        assert (pull[2:-2] > 0).all() and pull[:2].sum() > 0 and pull[-2:].sum() > 0


@pytest.mark.parametrize("turn", [(0, 0, np.pi / 2), (0.3, -1.2, 2.0)])
def test_rotating_the_world_changes_nothing(soles, moving, turn):
    pose, R = moving("walk"), roma.rotvec_to_rotmat(torch.tensor(turn, dtype=torch.float32))
    pelvis = soles.joints[0]
    rotations = pose.rotations.clone()
    rotations[:, 0] = roma.rotmat_to_rotvec(R @ roma.rotvec_to_rotmat(rotations[:, 0]))
    other = Pose(rotations, (pelvis + pose.transl) @ R.T - pelvis, pose.expression)
    ground = under(soles, other, CAMERA @ R.T)
    assert nats(soles, other, ground) == pytest.approx(nats(soles, pose), abs=2e-3)
