"""Laws of a whole optimisation, on evidence that needs no images."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.ground import Soles
from gva_mi.refine import SequenceOptions
from gva_mi.refine.optimize import descend
from gva_mi.refine.vector_adam import lever_arms
from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.errors.poses import CameraTilt, tilted
from gva_mi.synthetic.motion.motions import perform, times

N = 48
BODY = slice(1, 22)  # joints with errors
OPTIONS = SequenceOptions(passes=20, learn=8, batch=8)
CAMERA = Camera(100, 100, 50, 50, look_at((0, 0, 3), (0, 0, 0)), 100, 100)
METRE, NEAR = 10.0, 0.005  # as for images: 10 mm cost about 0.1, less within 5 mm
joint = JOINTS.index


class Sight:
    """Evidence of where the joints are in the image, and not how deep."""

    shared, unseen, distance_shown, surface_known = (), (), False, False

    def __init__(self, person, true, camera, soles=None):
        self.frames, self.camera, self.anatomy = range(len(true)), camera, person.anatomy
        self.soles = soles
        aside = torch.from_numpy(camera.T_camera_world[:2, :3].copy()).float().T
        self._look = lambda pose: person.places(pose) @ aside
        self._seen = self._look(true)

    def loss(self, frames, pose):
        away = self._look(pose) - self._seen[list(frames)]
        return METRE * (away.square().sum(-1) + NEAR**2).sqrt().mean()

    def energy(self):
        return 0.0

    def enable_details(self):
        pass


class Person:
    def __init__(self, body):
        self.rest = body.j_template
        self.anatomy = Anatomy.of(self.rest)
        mean = body.rest(Shape(torch.zeros(10)))
        self._arms = lever_arms(mean, body.weights, PARENTS)
        self.soles = Soles.of(mean, body.weights)

    def places(self, pose):
        """Joints of the body (T, 22, 3), metres."""
        T = turn_joints(pose.rotations, self.rest, PARENTS, pose.transl)[1]
        return (T[..., :3, 3] + (T[..., :3, :3] @ self.rest[..., None])[..., 0])[:, :22]

    def find(self, true, stage1, camera=CAMERA, options=OPTIONS, soles=None):
        return descend(Sight(self, true, camera, soles), stage1, self._arms, options).pose

    def away(self, pose, true):
        """Errors of the joints (T, 22, 3), metres."""
        return self.places(pose) - self.places(true)


@pytest.fixture(scope="module")
def person(body):
    return Person(body)


def moving(t):
    """A person who turns once and moves the arms, at moments (T,) of the round."""
    t = 2 * torch.pi * torch.as_tensor(t, dtype=torch.float32)
    pose = Pose.rest(len(t))
    pose.rotations[:, 0, 1] = t
    for side, sign in (("left", 1), ("right", -1)):
        pose.rotations[:, joint(f"{side}_shoulder"), 2] = sign * (0.3 * torch.sin(3 * t) - 0.8)
        pose.rotations[:, joint(f"{side}_elbow"), 1] = -sign * (0.5 + 0.4 * torch.sin(2 * t))
    return pose


TURNING = moving(np.arange(N) / N)


def with_errors(pose, errors):
    """The pose with its joints turned by (T, 21, 3), radians."""
    rotations = pose.rotations.clone()
    rotations[:, BODY] = roma.rotvec_composition([rotations[:, BODY], errors])
    return replace(pose, rotations=rotations)


def with_white_errors(pose, size=0.1):
    generator = torch.Generator().manual_seed(0)
    return with_errors(pose, size * torch.randn(len(pose), 21, 3, generator=generator))


def lasting_errors(rng, frames, sigma):
    """Errors (frames, 21, 3) of 0.1 rad that last for about sigma frames."""
    from scipy.ndimage import gaussian_filter1d

    errors = gaussian_filter1d(rng.normal(size=(frames + 80, 21, 3)), sigma, axis=0)[40:-40]
    return torch.from_numpy(0.1 * errors / errors.std()).float()


def moving_average(pose, half):
    """The mean over neighbours; at the ends over fewer, as many before as after."""
    R, n = roma.rotvec_to_rotmat(pose.rotations), len(pose)
    reach = [min(half, k, n - 1 - k) for k in range(n)]
    mean = torch.stack([R[k - h : k + h + 1].mean(0) for k, h in enumerate(reach)])
    return replace(pose, rotations=roma.rotmat_to_rotvec(roma.special_procrustes(mean)))


def rms(x):
    return float(x.square().sum(-1).mean().sqrt())


def gain(found, true, *columns):
    """How much of the true motion of one rotation's coordinate is found."""
    found, true = (pose.rotations[:, *columns] for pose in (found, true))
    true = true - true.mean()
    return float(found @ true / (true @ true))


@pytest.fixture(scope="module")
def found(person):
    """Of a person who turns, under white errors."""
    return person.find(TURNING, with_white_errors(TURNING))


def test_white_errors_fall_to_half_of_the_best_moving_average(person, found):
    """In depth, too, which the evidence does not show."""
    stage1, left = with_white_errors(TURNING), person.away(found, TURNING)
    means = [person.away(moving_average(stage1, half), TURNING) for half in range(9)]
    assert rms(left) < 0.5 * min(rms(mean) for mean in means)
    assert rms(left[..., 2:]) < 0.65 * min(rms(mean[..., 2:]) for mean in means)


def test_true_poses_stay_nearly_true(person):
    assert rms(person.away(person.find(TURNING, TURNING), TURNING)) < 0.008


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "errors"), [(45, 0.1), (16, 0.05)])
def test_high_and_low_steps_survive(person, degrees, errors):
    true, phase = TURNING.map(torch.clone), torch.arange(N) * torch.pi / 12
    for side, start in (("left", 0), ("right", torch.pi)):
        up = np.radians(degrees) * (0.5 - 0.5 * torch.cos(phase + start))
        true.rotations[:, joint(f"{side}_hip"), 0] = -up
        true.rotations[:, joint(f"{side}_knee"), 0] = 2 * up
    found = person.find(true, with_white_errors(true, errors))
    for name in ("left_hip", "right_hip", "left_knee", "right_knee"):
        assert 0.8 < gain(found, true, joint(name), 0) < 1.1


def test_a_camera_locked_tilt_of_the_legs_is_removed(person):
    tilt = tilted(TURNING.rotations.double().numpy(), CAMERA, CameraTilt(legs=np.radians(4)))
    stage1 = with_white_errors(replace(TURNING, rotations=torch.from_numpy(tilt).float()), 0.05)

    def tilts(pose):
        depth = person.away(pose, TURNING)[..., 2]
        legs = [joint(f"{side}_{name}") for side in ("left", "right") for name in ("knee", "ankle")]
        return abs(float((depth[:, legs] - depth[:, :1]).mean()))

    assert tilts(person.find(TURNING, stage1)) < 0.06 * tilts(stage1)


@pytest.mark.parametrize(
    "name", ["hip", *(pytest.param(name, marks=pytest.mark.slow) for name in ("shoulder", "elbow"))]
)
def test_a_gesture_once_per_turn_is_no_tilt(person, name):
    """A limb that moves toward the camera whenever the person faces it."""
    true, wave = TURNING.map(torch.clone), torch.cos(torch.arange(N) * 2 * torch.pi / N)
    moved = joint(f"left_{name}")
    true.rotations[:, moved] += wave[:, None] * torch.tensor([-0.3, 0, 0])
    found = person.find(true, with_white_errors(true, 0.05))
    assert 0.85 < gain(found, true, moved, 0) < 1.1


@pytest.mark.slow
def test_twice_the_frame_rate_leaves_the_same_errors(person):
    """Of a motion in half as large steps, under errors that last for twice as many frames."""
    n = 32
    errors = lasting_errors(np.random.default_rng(0), 2 * n, 10.0)
    stage1, left = [], []
    for count, batch in ((n, 4), (2 * n, 8)):
        true = moving(np.arange(count) / count)
        pose = with_errors(true, errors[:: 2 * n // count])
        found = person.find(true, pose, options=replace(OPTIONS, batch=batch))
        stage1.append(rms(person.away(pose, true)))
        left.append(rms(person.away(found, true)))
    assert max(left) < 0.3 * min(stage1)
    assert abs(left[1] - left[0]) < 0.05 * stage1[0]


@pytest.mark.slow
def test_the_ground_corrects_the_height_of_feet_and_not_their_depth(person):
    """Seen from above, under lasting errors of the legs."""
    above = Camera(100, 100, 50, 50, look_at((0, 1.5, 2.6), (0, 0, 0)), 100, 100)
    sight = torch.from_numpy(above.T_camera_world[2, :3].copy()).float()
    feet = [joint(f"{side}_{name}") for side in ("left", "right") for name in ("ankle", "foot")]
    heights = lambda pose: person.soles.places(pose.rotations, pose.transl)[..., 1]
    square_depth, square_height = np.zeros((2, 4)), np.zeros((2, 4))
    for draw in range(4):
        rng = np.random.default_rng(1 + draw)
        true = perform("half", times(N), person.rest.double().numpy(), 10, rng)
        stage1 = with_errors(true, lasting_errors(rng, N, 6.0))
        for row, soles in enumerate((None, person.soles)):
            found = person.find(true, stage1, above, soles=soles)
            depth = (person.away(found, true) @ sight)[:, feet]
            square_depth[row, draw] = float(depth.square().mean())
            square_height[row, draw] = float((heights(found) - heights(true)).var())
    height, depth = (x.mean(1) ** 0.5 for x in (square_height, square_depth))
    assert (square_height[1] < square_height[0]).all() and height[1] < 0.8 * height[0]
    assert depth[1] < depth[0]


@pytest.mark.parametrize(
    ("frames", "least"),
    [(N, 0.98), *(pytest.param(*x, marks=pytest.mark.slow) for x in ((3, 0.8), (8, 0.95)))],
)
def test_the_ground_does_not_stop_a_turntable(person, frames, least):
    true, often = moving(0.02 * np.arange(frames)), N // frames
    options = replace(OPTIONS, batch=max(1, 8 // often), passes=20 * often, learn=8 * often)
    found = person.find(true, true, options=options, soles=person.soles)
    expected = true.rotations[:, 0, 1]
    turned = roma.rotvec_to_rotmat(found.rotations[:, 0])
    yaw = torch.from_numpy(np.unwrap(torch.atan2(turned[:, 0, 2], turned[:, 2, 2]).numpy()))
    assert least < float((yaw[-1] - yaw[0]) / (expected[-1] - expected[0])) < 1.02


def test_rotating_the_world_changes_nothing(person, found):
    turn = torch.tensor([-2.0, 1.0, 1.5])
    R = roma.rotvec_to_rotmat(turn)

    def turned(pose):
        rotations = pose.rotations.clone()
        rotations[:, 0] = roma.rotvec_composition([turn.expand(N, 3), rotations[:, 0]])
        pelvis = person.rest[0]
        return Pose(rotations, (pose.transl + pelvis) @ R.T - pelvis, pose.expression)

    T_new_world = np.eye(4)
    T_new_world[:3, :3] = R.T.double().numpy()
    camera = replace(CAMERA, T_camera_world=CAMERA.T_camera_world @ T_new_world)
    other = person.find(turned(TURNING), turned(with_white_errors(TURNING)), camera)
    apart = person.places(other) - person.places(found) @ R.T
    assert float(apart.abs().max()) < 1e-3  # of errors of 90 mm
