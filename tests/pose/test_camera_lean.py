"""Laws of what a motion has of the camera."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.pose.camera_lean import LEAST, LIMBS, CameraTilt
from gva_mi.pose.stage1 import Stage1
from gva_mi.splat import Camera, look_at

N = 48
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)
KNEE = JOINTS.index("left_knee")
DEPTH, SIDEWAYS = torch.eye(3)[[0, 2]]  # axes of the camera, about which a limb turns


def turning(rounds=1.0):
    """A person who turns round, with limbs that are bent somehow and move by chance."""
    generator, pose = torch.Generator().manual_seed(0), Pose.rest(N)
    bent = 0.3 * torch.randn(1, 21, 3, generator=generator)
    phase = torch.rand(1, 21, 3, generator=generator)
    t = torch.arange(N)[:, None, None] / N
    # By other rhythms than that of the turn.
    sways = 0.1 * torch.sin(2 * torch.pi * (3 * t + phase))
    pose.rotations[:, LIMBS] = roma.rotvec_composition([bent.expand(N, 21, 3), sways])
    pose.rotations[:, 0, 1] = 2 * torch.pi * rounds * torch.arange(N) / N
    return pose


def leaning(pose, angle, axis=DEPTH, joint=KNEE):
    """A joint turned by the same angle about an axis of the camera in every frame."""
    stage1 = Stage1.of(pose, range(N), CAMERA)
    turns = torch.zeros(N, len(JOINTS), 3)
    turns[:, joint] = angle * axis
    return stage1.corrected(range(N), turns, torch.zeros(N, 3))


def nats(pose, rotations=None):
    stage1 = Stage1.of(pose, range(N), CAMERA)
    shown = pose.rotations
    return CameraTilt.of(stage1, shown).energy(shown if rotations is None else rotations)


@pytest.mark.parametrize("axis", [DEPTH, SIDEWAYS], ids=["in depth", "sideways"])
def test_it_is_the_angle_that_a_joint_leans_by(axis):
    pose, angle = turning(), np.radians(4)
    lean = CameraTilt.of(Stage1.of(pose, range(N), CAMERA), pose.rotations)
    before, after = (
        lean._of(lean._turns(p.rotations))[KNEE - 1] for p in (pose, leaning(pose, angle, axis))
    )
    assert torch.allclose(after - before, angle * axis, atol=0.1 * angle)


def test_motions_of_other_rhythms_are_by_chance():
    assert float(nats(turning())) < 0.1


def test_a_lean_in_depth_costs_and_one_that_pictures_show_does_not():
    pose = turning()
    stage1 = Stage1.of(pose, range(N), CAMERA)
    lean = CameraTilt.of(stage1, pose.rotations)
    cost = lambda axis: float(lean.energy(leaning(pose, np.radians(4), axis).rotations))
    assert cost(DEPTH) > 1
    assert cost(SIDEWAYS) < 0.1 * cost(DEPTH)


def test_who_sways_sideways_by_as_much_may_lean_by_it():
    """All joints do: then it is how this person moves."""
    pose = turning()
    for joint in range(1, 22, 2):
        pose = leaning(pose, np.radians(4), SIDEWAYS, joint)
    tilted = leaning(pose, np.radians(4))
    stage1 = Stage1.of(pose, range(N), CAMERA)
    assert float(CameraTilt.of(stage1, pose.rotations).energy(tilted.rotations)) < 0.5


def test_who_does_not_turn_may_lean():
    pose = turning(rounds=0.0)
    lean = CameraTilt.of(Stage1.of(pose, range(N), CAMERA), pose.rotations)
    # Nothing of them but what their limbs turn, of whose frames the axes are.
    assert float(lean.energy(leaning(pose, np.radians(6)).rotations)) < 0.5


def test_any_number_of_frames_tells_no_more_than_one():
    once, again = turning(), turning()
    again = Pose(*(torch.cat([x, x]) for x in (again.rotations, again.transl, again.expression)))
    leans = []
    for pose in (once, again):
        stage1 = Stage1.of(pose, range(len(pose)), CAMERA)
        lean = CameraTilt.of(stage1, pose.rotations)
        turns = torch.zeros(len(pose), len(JOINTS), 3)
        turns[:, KNEE, 0] = np.radians(4)
        tilted = stage1.corrected(range(len(pose)), turns, torch.zeros(len(pose), 3))
        leans.append(float(lean.energy(tilted.rotations)))
    assert leans[1] == pytest.approx(leans[0], rel=1e-3)


def test_no_direction_of_the_world_is_special():
    turn = torch.tensor([-2.0, 1.0, 1.5])
    pose, R = turning(), roma.rotvec_to_rotmat(turn)
    rotations = pose.rotations.clone()
    rotations[:, 0] = roma.rotvec_composition([turn.expand(N, 3), rotations[:, 0]])
    T_new_world = np.eye(4)
    T_new_world[:3, :3] = R.T.double().numpy()
    camera = replace(CAMERA, T_camera_world=CAMERA.T_camera_world @ T_new_world)
    a, b = (
        CameraTilt.of(Stage1.of(p, range(N), c), p.rotations)
        for p, c in ((pose, CAMERA), (replace(pose, rotations=rotations), camera))
    )
    assert torch.allclose(a.chance, b.chance, rtol=1e-3)
    assert torch.allclose(a.swings, b.swings, atol=1e-5)


@pytest.mark.parametrize("rounds", [0.05, 0.25, 0.4])
def test_who_turns_less_than_half_round_is_left_alone(rounds):
    pose = turning(rounds)
    assert float(nats(pose, leaning(pose, np.radians(6)).rotations)) == 0


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_few_frames_that_rest_cost_nothing(frames):
    pose = Pose.rest(frames)
    lean = CameraTilt.of(Stage1.of(pose, range(frames), CAMERA), pose.rotations)
    assert float(lean.chance.min()) >= LEAST * 0.999
    assert float(lean.energy(pose.rotations)) == 0


def test_a_person_at_rest_who_turns_has_a_slope():
    """Also where no joint leans at all."""
    pose = Pose.rest(N)
    pose.rotations[:, 0, 1] = 2 * torch.pi * torch.arange(N) / N
    rotations = pose.rotations.clone().requires_grad_()
    nats(pose, rotations).backward()
    assert bool(rotations.grad.isfinite().all())


def test_gradient_matches_differences():
    pose = turning()
    lean = CameraTilt.of(Stage1.of(pose, range(N), CAMERA), pose.rotations)
    to64 = lambda x: x.double()
    lean = CameraTilt(*map(to64, (lean.means, lean.swings, lean.across, lean.chance)), True)
    x = leaning(pose, np.radians(4)).rotations.double().requires_grad_()
    generator = torch.Generator().manual_seed(1)
    d = torch.randn(x.shape, generator=generator, dtype=torch.float64)
    lean.energy(x).backward()
    h = 1e-6
    with torch.no_grad():
        slope = (lean.energy(x + h * d) - lean.energy(x - h * d)) / (2 * h)
    assert float((x.grad * d).sum()) == pytest.approx(float(slope), rel=1e-6)
    assert abs(float(slope)) > 0.1
