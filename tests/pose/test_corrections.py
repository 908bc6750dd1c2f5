"""Corrections start where stage 1 is most probably right, and tell how it erred."""

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.pose.anatomy import Anatomy
from gva_mi.pose.corrections import Corrections, constant_shifts
from gva_mi.pose.noise import GROUPS
from gva_mi.pose.stage1 import Stage1

ELBOW = JOINTS.index("left_elbow")
FACE = slice(JOINTS.index("jaw"), JOINTS.index("right_eye_smplhf") + 1)


def at_rest(frames=7):
    return Pose.rest(frames)


@pytest.fixture
def make(camera, body):
    anatomy = Anatomy.of(body.j_template)

    def corrections(pose, frames=None):
        frames = range(len(pose)) if frames is None else frames
        return Corrections.likeliest(Stage1.of(pose, frames, camera), anatomy)

    return corrections


def matrices(pose):
    return roma.rotvec_to_rotmat(pose.rotations.detach())


def test_at_rest_nothing_is_corrected(make):
    found = make(at_rest()).pose([2, 0])
    torch.testing.assert_close(found.rotations, at_rest(2).rotations, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.transl, at_rest(2).transl, atol=1e-6, rtol=0)


def test_a_single_frame_stays_as_it_is(make, true_pose):
    found = make(true_pose, frames=[1]).pose([0])
    torch.testing.assert_close(matrices(found), matrices(true_pose[[1]]), atol=1e-5, rtol=0)


def test_a_step_of_one_frame_moves_its_neighbours_less_and_less(make):
    corrections = make(at_rest())
    with torch.no_grad():
        corrections.turns[3, ELBOW, 0] = 1.0
    angle = corrections.pose(range(7)).rotations[:, ELBOW].norm(dim=1).detach()
    assert (angle > 0).all() and angle.argmax() == 3
    torch.testing.assert_close(angle, angle.flip(0), atol=1e-4, rtol=0)
    assert (angle[:4].diff() > 0).all()


def test_frames_far_from_each_other_pull_less(make):
    """Errors of stage 1 are forgotten, and people move."""
    corrections = make(at_rest(60), frames=[0, 1, 58, 59])
    with torch.no_grad():
        corrections.turns[1, ELBOW, 0] = 1.0
    near, far = corrections.pose([0, 2]).rotations[:, ELBOW].norm(dim=1).detach()
    assert far < near


def test_turns_are_in_the_axes_of_the_camera(make, camera, true_pose):
    """About the line of sight: what hangs on the joint turns in the picture, wherever it points."""
    corrections, T = make(true_pose, frames=[0]), 1
    before = corrections.pose([0])
    with torch.no_grad():
        corrections.turns[:, ELBOW, 2] = 0.25
    after, joints = corrections.pose([0]), torch.zeros(1, 55, 3)
    G = [
        turn_joints(pose.rotations.detach(), joints, PARENTS, torch.zeros(T, 3))[1]
        for pose in (before, after)
    ]
    turned = G[1][:, ELBOW, :3, :3] @ G[0][:, ELBOW, :3, :3].mT
    sight = torch.tensor(camera.T_camera_world[2, :3]).float()
    turned = roma.rotmat_to_rotvec(turned)[0]
    assert float(turned.norm()) > 0.1
    torch.testing.assert_close(turned / turned.norm(), sight, atol=1e-4, rtol=0)


def test_shifts_are_in_the_axes_of_the_camera(make, camera):
    corrections = make(at_rest(1))
    with torch.no_grad():
        corrections.moves[:, 2] = 0.25
    moved = corrections.pose([0]).transl[0].detach().numpy()
    np.testing.assert_allclose(
        moved / np.linalg.norm(moved), camera.T_camera_world[2, :3], atol=1e-6
    )


def test_the_face_stays(make, true_pose):
    corrections = make(true_pose)
    with torch.no_grad():
        corrections.turns += 0.5
    found = corrections.pose(range(len(true_pose))).rotations[:, FACE].detach()
    torch.testing.assert_close(found, true_pose.rotations[:, FACE])


def test_to_put_all_frames_elsewhere_costs_unless_pictures_show_the_distance(make, true_pose):
    corrections = make(true_pose)
    with torch.no_grad():
        before = [corrections.energy(distance_shown) for distance_shown in (False, True)]
        corrections.moves += 0.5
        after = [corrections.energy(distance_shown) for distance_shown in (False, True)]
    dear, cheap = (float(b - a) for a, b in zip(before, after, strict=True))
    assert dear > 2 * cheap > 0


def test_a_tilt_of_the_person_costs_in_every_frame_a_lean_of_a_limb_once(body, camera):
    """Though neither is a motion: clothes would tilt the person a little in every picture."""
    anatomy = Anatomy.of(body.j_template)

    def nats(joint, frames):
        """What 0.05 rad toward the camera in all frames cost, in each."""
        stage1 = Stage1.of(at_rest(frames), range(frames), camera)
        turns = torch.zeros(frames, len(JOINTS), 3)
        turns[:, JOINTS.index(joint), 0] = 0.05
        prior = Corrections.likeliest(stage1, anatomy).prior
        found = Corrections(stage1, anatomy, prior, turns, torch.zeros(frames, 3))
        return float(found.energy().detach())

    few, many = 8, 64
    assert nats("pelvis", many) > 0.9 * nats("pelvis", few) > 0.1
    assert nats("left_hip", many) < 0.3 * nats("left_hip", few)


@pytest.mark.parametrize("round", [1.0, 0.0], ids=["who turns round", "who does not turn"])
def test_what_is_the_same_in_all_frames_may_cost_in_each(body, camera, round):
    """However many they are, in the axes of the camera: a swing to both sides costs nothing."""
    anatomy, costs = Anatomy.of(body.j_template), []
    for frames in (8, 64):
        pose = at_rest(frames)
        pose.rotations[:, 0] = 0
        pose.rotations[:, 0, 1] = 2 * torch.pi * round * torch.arange(frames) / frames
        stage1 = Stage1.of(pose, range(frames), camera)
        prior = Corrections.likeliest(stage1, anatomy).prior
        turns = torch.zeros(frames, len(JOINTS), 3)
        turns[:, JOINTS.index("left_hip"), 0] = 0.05
        swing = turns * torch.tensor([1.0, -1.0]).repeat(frames // 2)[:, None, None]
        same, none = (
            float(Corrections(stage1, anatomy, prior, x, torch.zeros(frames, 3)).constant_turn_energy())
            for x in (turns, swing)
        )
        assert none < 1e-9
        costs.append(same)
    if round:
        assert costs[1] > 0.9 * costs[0] > 0.1
    else:
        assert max(costs) < 1e-6


def test_gradient_matches_differences(make, true_pose):
    corrections = make(true_pose)
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

    assert slope == pytest.approx((at(2e-3) - at(-2e-3)) / 4e-3, rel=5e-3)


def test_what_pictures_corrected_tells_how_stage_1_erred(make):
    """Errors of 0.2 rad that last for about six frames, at the elbows alone."""
    from scipy.ndimage import gaussian_filter1d

    rng, frames = np.random.default_rng(0), 120
    errors = gaussian_filter1d(rng.normal(size=(frames + 40, 2, 3)), 6.0, axis=0)[20:-20]
    errors = torch.from_numpy(0.2 * errors / errors.std()).float()
    corrections = make(at_rest(frames))
    elbows = list(GROUPS["elbows"])
    with torch.no_grad():
        corrections.start[0][:, elbows] = -errors
    renewed = corrections.told_by(*corrections.found())
    noise = renewed.prior.noise
    assert noise["elbows"].slow == pytest.approx(0.2, rel=0.4)
    assert 3 <= noise["elbows"].memory <= 12
    assert noise["knees"].slow < 0.5 * noise["elbows"].slow
    before, after = (c.pose(range(frames)) for c in (corrections, renewed))
    torch.testing.assert_close(matrices(after), matrices(before))


def turning(frames=12):
    """Someone who turns by 30 degrees a frame, and leans."""
    pose = Pose.rest(frames)
    around = torch.zeros(frames, 3)
    around[:, 1] = torch.arange(frames) * np.pi / 6
    lean = torch.tensor([0.2, 0.0, 0.1]).expand(frames, 3)
    pose.rotations[:, 0] = roma.rotvec_composition([around, lean])
    return pose


@pytest.mark.parametrize("axes", ["camera", "body"])
def test_what_another_shape_would_show_is_taken_away(make, axes):
    corrections = make(turning())
    before = corrections.pose(range(12))
    n = len(before)
    turns, moves = torch.zeros(corrections.start[0].shape), torch.zeros(n, 3)
    of_joints = torch.tensor([0.1, -0.2, 0.05])
    turns[:] = of_joints
    shift = torch.tensor([0.01, 0.02, -0.03])
    R_camera_body = corrections._stage1.R_joint_camera[:, 0].mT
    moves[:] = shift if axes == "camera" else R_camera_body @ shift
    turns0, moves0 = corrections.start
    corrections.start = turns0 + corrections._stage1.in_camera(turns), moves0 + moves
    corrections.centre()
    after = corrections.pose(range(12))
    torch.testing.assert_close(after.transl, before.transl, atol=1e-6, rtol=0)
    torch.testing.assert_close(matrices(after), matrices(before), atol=1e-5, rtol=0)


def test_a_shift_that_differs_from_frame_to_frame_stays():
    """And is smaller by what is constant of it, in the axes of a body that turns or does not."""
    n = 12
    turn = roma.rotvec_to_rotmat(turning(n).rotations[:, 0])
    shifts = torch.zeros(n, 3)
    shifts[5, 2] = 0.05
    for R in (turn.mT, torch.eye(3).expand(n, 3, 3)):
        constant = constant_shifts(shifts, R)
        assert constant.norm() < 0.75 * shifts.norm()
        rest = shifts - constant
        torch.testing.assert_close(rest.mean(0), torch.zeros(3), atol=1e-7, rtol=0)
        of_body = (R @ rest[..., None])[..., 0].mean(0)
        torch.testing.assert_close(of_body, torch.zeros(3), atol=1e-7, rtol=0)
        torch.testing.assert_close(constant_shifts(rest, R), torch.zeros(n, 3), atol=1e-7, rtol=0)
