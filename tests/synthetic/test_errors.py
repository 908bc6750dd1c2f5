"""Error models: what they draw, and what it does to poses, masks and normals."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import BODY, HANDS, JOINTS, PARENTS, Pose, Shape, mirrored_name
from gva_mi.splat import Camera, look_at
from gva_mi.synthetic.errors.masks_and_normals import (
    Confusion,
    MaskErrors,
    NormalErrors,
    confusions,
    noisy_mask,
    noisy_normals,
)
from gva_mi.synthetic.errors.models import ERROR_MODELS, ErrorParameters, draw_errors
from gva_mi.synthetic.errors.poses import (
    CameraTilt,
    JointFactors,
    Outliers,
    PoseErrors,
    estimated_camera,
    jumps,
    lose_hands,
    mean_hand,
    noisy_poses,
    swap_legs,
    tilted,
)

FRAMES = 600
STILL_MASK = MaskErrors(wobble=0.0, notches=0)
NOTHING = PoseErrors(sizes=JointFactors(0, 0, 0, 0, 0), depth=0, aside=0, betas=0, expression=0,
    outliers=Outliers(lost=0))  # fmt: skip


@pytest.fixture(scope="session")
def camera():
    return Camera(80, 80, 32, 32, look_at((0, 1, 3), (0, 1, 0)), 64, 64)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def turning():
    """Poses of 24 frames and a shape."""
    pose = Pose.rest(24)
    pose.rotations[:, 0, 1] = torch.arange(24) * (2 * torch.pi / 24)
    return pose, Shape(torch.zeros(10))


@pytest.fixture
def disc():
    """A ball seen from the front: mask (H, W), normals (H, W, 3)."""
    y, x = np.mgrid[:64, :64] - 31.5
    r = np.hypot(x, y) / 24
    z = -np.sqrt(np.maximum(1 - r**2, 0))
    inside = r < 1
    normals = np.stack([x / 24, y / 24, z], axis=-1) * inside[..., None]
    return np.clip(24.5 - 24 * r, 0, 1).astype(np.float32), normals.astype(np.float32)


def test_error_models_draw_from_their_seed_in_their_ranges():
    drawn = {name: [draw_errors(name, seed) for seed in range(8)] for name in ERROR_MODELS}
    assert draw_errors("none", 0) is None and set(drawn["bursts"]) == {ErrorParameters()}
    for name in drawn.keys() - {"bursts"}:
        assert len({errors.pose.memory for errors in drawn[name]}) == 8, name
        assert draw_errors(name, 3) == drawn[name][3]
    assert all(errors.pose.white == 1 for errors in drawn["white"])
    assert all(errors.pose.depth_follows for errors in drawn["shape"])
    assert all(15 <= errors.pose.memory <= 20 for errors in drawn["slow"])
    assert all(0.034 < errors.pose.lean.legs < 0.105 for errors in drawn["lean"])  # rad
    assert all(0.04 <= abs(errors.pose.focal) <= 0.1 for errors in drawn["focal"])
    assert {errors.normal.convention for errors in drawn["normals"]} == {"perspective", "icon"}
    assert all(errors.mask == MaskErrors() for errors in drawn["bursts"])
    assert all(errors.mask.bag == errors.pose.focal == 0 for errors in drawn["mixed"])


@pytest.fixture
def rotations(rng):
    return 0.4 * rng.normal(size=(FRAMES, 55, 3))


def test_a_lost_hand_is_the_mean_hand(rotations, rng):
    after = rotations.copy()
    lose_hands(after, 0.2, rng)
    for side, hand in HANDS.items():
        lost = (rotations[:, hand] != after[:, hand]).any((1, 2))
        assert 0.1 < lost.mean() < 0.3
        assert np.allclose(after[lost][:, hand], mean_hand(side))
        assert not after[lost, JOINTS.index(f"{side}_wrist")].any()


def test_swapped_legs_are_mirrored(rotations, rng):
    after = rotations.copy()
    swap_legs(after, 0.2, rng)
    where = (rotations != after).any((1, 2))
    assert 0.1 < where.mean() < 0.3
    legs = [k for k, name in enumerate(JOINTS) if name.endswith(("hip", "knee", "ankle", "foot"))]
    others = [JOINTS.index(mirrored_name(JOINTS[k])) for k in legs]
    assert np.array_equal(after[where][:, legs], rotations[where][:, others] * (1, -1, -1))
    assert np.array_equal(np.delete(after, legs, 1), np.delete(rotations, legs, 1))


def test_a_jump_lasts_and_is_one_displacement(rng):
    moved = jumps(FRAMES, Outliers(jumps=0.2, jump=0.08), rng)
    away = moved.any(1)
    assert 0.1 < away.mean() < 0.3
    same = (moved[1:] == moved[:-1]).all(1)
    assert same[away[1:] & away[:-1]].all()  # within a run of frames
    assert 0.04 < np.sqrt((moved[away] ** 2).sum(1).mean()) < 0.14  # m
    assert moved[away, 2].std() > moved[away, 0].std()  # mostly in depth


def test_a_tilt_is_one_rotation_in_camera_axes_while_the_person_turns(turning, camera, rng):
    rotations = turning[0].rotations.double().numpy()
    rotations[:, 1:] = 0.3 * rng.normal(size=(24, 54, 3))
    nowhere = torch.zeros(55, 3).double(), PARENTS, torch.zeros(24, 3).double()
    turns = lambda r: joint_transforms(torch.from_numpy(r), *nowhere)[..., :3, :3].numpy()
    lean, C = CameraTilt(legs=0.1, trunk=0.04, arms=0.06), camera.T_camera_world[:3, :3]
    before, after = (C @ turns(r) for r in (rotations, tilted(rotations, camera, lean)))
    L = after @ before.swapaxes(-1, -2)
    for names, angle in (
        (("left_hip", "right_knee", "left_foot"), -0.1),
        (("spine1", "head", "left_collar"), 0.04),
        (("left_shoulder", "right_wrist"), 0.04 - 0.06),
        (("pelvis",), 0.0),
    ):
        cos, sin = np.cos(angle), np.sin(angle)
        about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        for name in names:
            assert np.abs(L[:, JOINTS.index(name)] - about_x).max() < 1e-6, name


def test_a_person_estimated_larger_is_placed_farther_and_keeps_the_picture(body, turning, camera):
    """Only proportions change the picture: less than a quarter of the growth."""
    spread = lambda x: np.sqrt(((x - x[:, :1]) ** 2).mean())
    joints = lambda found: body(*found).joints.double().numpy()[:, :22]
    noise = replace(NOTHING, betas=0.6, depth_follows=True)
    grown, left = [], []
    for seed in range(6):
        larger = noisy_poses(body, *turning, camera, noise, np.random.default_rng(seed))
        grown.append(spread(joints(larger)) / spread(joints(turning)) - 1)
        seen, true = (camera.project(joints(found)) for found in (larger, turning))
        left.append(spread(seen) / spread(true) - 1)
        assert np.abs(seen[:, 0] - true[:, 0]).max() < 0.01  # px, the pelvis
    assert np.abs(grown).mean() > 0.02
    assert np.abs(left).mean() < 0.25 * np.abs(grown).mean()


def test_another_focal_length_moves_the_person_and_keeps_the_picture(body, turning, camera):
    noise = replace(NOTHING, focal=0.1)
    found = noisy_poses(body, *turning, camera, noise, np.random.default_rng(4))
    estimated = estimated_camera(camera, noise)
    assert estimated.fx == pytest.approx(1.1 * camera.fx) and estimated.cx == camera.cx
    pixels = lambda of, seen_by: seen_by.project(body(*of).vertices[:, ::50].double().numpy())
    off = pixels(found, estimated) - pixels(turning, camera)
    assert np.abs(off).max() < 0.025 * 64  # of the picture's width; perspective alone is left
    z = (found[0].transl - turning[0].transl).double().numpy() @ camera.T_camera_world[2, :3]
    assert np.allclose(z, 0.1 * 3, atol=0.05)  # m, of 3


def test_white_noise_is_independent_from_frame_to_frame(body, camera, rng):
    white = PoseErrors(white=1.0, outliers=Outliers(lost=0.0))
    standing = Pose.rest(400), Shape(torch.zeros(10))
    error = noisy_poses(body, *standing, camera, white, rng)[0].rotations[:, BODY]
    for lag in (1, 3, 10):
        assert abs((error[lag:] * error[:-lag]).mean() / error.pow(2).mean()) < 0.03


def test_a_mask_is_off_at_its_boundary_only(disc, rng):
    mask, _ = disc
    noisy = noisy_mask(mask, MaskErrors(), rng)
    y, x = np.mgrid[:64, :64] - 31.5
    r = np.hypot(x, y)
    assert not np.array_equal(noisy, mask)
    assert (noisy[r < 20] == 1).all() and (noisy[r > 28] == 0).all()
    assert ((noisy > 0.5) & (mask > 0.5)).sum() > 0.9 * ((noisy > 0.5) | (mask > 0.5)).sum()
    numbers = (0.103937, 0.780935, 0.786507, 0.826753)  # published figures depend on them
    assert np.allclose(noisy[8, 26:30], numbers, rtol=0, atol=2e-6)


@pytest.mark.parametrize("grown", [-20.0, 20.0])
def test_a_boundary_is_shifted_all_around(disc, rng, grown):
    """20 pixels at width 512 are 2.5 pixels here; the radius is 24."""
    area = noisy_mask(disc[0], replace(STILL_MASK, grown=grown), rng).sum()
    assert abs(np.sqrt(area / np.pi) - (24 + np.sign(grown) * 2.5)) < 0.5


def test_a_foot_is_cut_off_and_a_bag_is_added_where_they_are(disc, rng):
    seen = Confusion((((32, 44), (0, 1), 30),), (58, 20, 5))
    mask = noisy_mask(disc[0], STILL_MASK, rng, seen)
    assert not mask[46:].any() and (mask[36:42, 28:36] > 0.9).all()  # below the ankle; above it
    assert mask[20, 58] == 1 and mask[20, 52] == 1  # outside the ball


def test_feet_are_lost_in_runs_of_the_given_share(body, camera, rng):
    standing = Pose.rest(300), Shape(torch.zeros(10))
    found = confusions(body, *standing, camera, MaskErrors(lost_feet=0.3), rng)
    lost = np.array([len(seen.lost) for seen in found])
    assert 0.15 < lost.mean() / 2 < 0.45
    assert (np.diff(lost) != 0).mean() < 0.25


def test_normals_stay_unit_face_the_camera_and_fill_the_mask(disc, rng):
    mask, normals = disc
    wider = (np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 26).astype(np.float32)
    noisy = noisy_normals(normals, wider, NormalErrors(), rng)
    length = np.linalg.norm(noisy, axis=-1)
    assert np.allclose(length[wider > 0.5], 1, atol=1e-5) and (length[wider <= 0.5] == 0).all()
    assert (noisy[..., 2] <= 0).all()
    both = normals.any(-1) & noisy.any(-1)
    cosine = (noisy * normals).sum(-1)[both].clip(-1, 1)
    assert 2 < np.degrees(np.arccos(cosine)).mean() < 20
