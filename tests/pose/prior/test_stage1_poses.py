"""Joints that stage 1 has in the picture may move along their lines of sight, not aside."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.prior.stage1_poses import SeenJoints, Stage1Poses
from gva_mi.splat import Camera, look_at

N = 40
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)


@pytest.fixture(scope="module")
def joints(built_in_body):
    return built_in_body.rest(Shape(torch.zeros(1))).joints


@pytest.fixture
def term(joints):
    return SeenJoints.of(Stage1Poses.of(Pose.rest(N), range(N), CAMERA), joints, CAMERA)


def shifted(shift):
    """Frames of a person who stands aside by ``shift`` (n, 3) metres."""
    pose = Pose.rest(N)
    return Pose(pose.rotations, pose.transl + shift, pose.expression)


def nats(term, pose):
    return float(term.energy(pose.rotations, pose.transl, torch.arange(N)))


def test_the_size_of_its_errors_is_inferred_from_corrected_poses(term):
    generator = torch.Generator().manual_seed(0)
    errors = torch.randn(N, 3, generator=generator)
    found = term.inferred(shifted(0.014 * errors)).sigma
    assert found == pytest.approx(0.014, rel=0.25)
    assert term.inferred(shifted(torch.zeros(3))).sigma == 0.01  # never certain


def test_a_stage_1_that_the_pictures_contradict_holds_nothing(term):
    far = shifted(torch.tensor([0.06, 0, 0]))
    assert nats(term, far) == nats(term.inferred(far), far) == 0.0


def test_a_hand_may_move_along_its_line_of_sight_and_not_aside(term):
    """The arm stays as long as it is, so the hand moves along the line only nearly."""
    term = term.inferred(shifted(torch.zeros(3)))
    assert nats(term, Pose.rest(N)) == pytest.approx(0, abs=1e-6)
    cost, elbow = {}, JOINTS.index("left_elbow")
    for name, axis in (("depth", 1), ("aside", 2)):  # the forearm points along x
        pose = Pose.rest(N)
        pose.rotations[:, elbow, axis] = np.radians(5)
        cost[name] = nats(term, pose)
    assert 5 * cost["depth"] < cost["aside"]
