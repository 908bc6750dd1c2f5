"""What each pose error measures, and what it ignores."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.pose import JOINTS, LEFT_HAND, Shape
from gva_mi.body.smplx import load_body
from gva_mi.evaluate.pose_errors import pose_errors, within_region
from gva_mi.refine.uncertainty import Uncertainty
from gva_mi.subject.ground_truth import GroundTruth

SHAPE = Shape(torch.zeros(10))


@pytest.fixture
def truth(body, true_pose, camera):
    return GroundTruth(body, true_pose, SHAPE, [camera] * len(true_pose))


@pytest.fixture(scope="module")
def giant(body, tmp_path_factory):
    """A foreign body: the same one, a tenth larger, on other triangles."""
    file = tmp_path_factory.mktemp("giant") / "body.npz"
    with np.load(BUILT_IN_BODY) as arrays:
        np.savez(file, **{**arrays, "v_template": 1.1 * arrays["v_template"]})
    return load_body(file)


def turned(pose, joint, vector):
    rotations = pose.rotations.clone()
    rotations[:, JOINTS.index(joint)] += torch.tensor(vector)
    return replace(pose, rotations=rotations)


def moved(pose, vector):
    return replace(pose, transl=pose.transl + torch.as_tensor(vector, dtype=torch.float32))


def test_a_shift_is_an_error_but_not_pelvis_aligned(body, truth):
    errors = pose_errors(body, (moved(truth.pose, (0.03, 0.0, 0.04)), SHAPE), truth)
    for name in ("body", "hands", "feet", "joints"):
        torch.testing.assert_close(errors[name], torch.full((3,), 50.0), atol=1e-3, rtol=0)
    for name in ("body_aligned", "hands_aligned", "feet_aligned", "fingers"):
        assert errors[name].max() < 1e-3, name


def test_a_bent_finger_is_the_same_error_wherever_the_arm_is(body, truth):
    rotations = truth.pose.rotations.clone()
    rotations[:, LEFT_HAND, 2] += 0.4
    bent = replace(truth.pose, rotations=rotations)
    alone = pose_errors(body, (bent, SHAPE), truth)
    with_arm = pose_errors(body, (turned(bent, "left_elbow", (0, 0.7, 0)), SHAPE), truth)
    assert alone["fingers"].min() > 5 and with_arm["hands"].min() > 2 * alone["hands"].max()
    torch.testing.assert_close(alone["fingers"], with_arm["fingers"], atol=1e-2, rtol=0)


def test_depth_is_positive_if_a_limb_is_too_far_away(body, truth, camera):
    away = torch.tensor(camera.T_camera_world[2, :3])
    sideways = torch.tensor(camera.T_camera_world[0, :3])
    depths = ("pelvis_depth", "ankles_depth", "wrists_depth")
    for vector, mm in ((0.02 * away, 20.0), (-0.02 * away, -20.0), (0.02 * sideways, 0.0)):
        errors = pose_errors(body, (moved(truth.pose, vector), SHAPE), truth)
        for name in depths:
            torch.testing.assert_close(errors[name], torch.full((3,), mm), atol=1e-3, rtol=0)


def test_a_foreign_body_is_compared_by_its_joints(body, giant, truth):
    foreign = replace(truth, body=giant, foreign=True)
    errors = pose_errors(body, (truth.pose, SHAPE), foreign)
    found, true = (b(truth.pose, SHAPE).joints for b in (body, giant))
    apart = 1e3 * (found - true).norm(dim=2)
    torch.testing.assert_close(errors["body"], apart[:, :22].mean(1))
    torch.testing.assert_close(errors["joints"], errors["body"])
    feet = [JOINTS.index(f"{side}_{j}") for side in ("left", "right") for j in ("ankle", "foot")]
    torch.testing.assert_close(errors["feet"], apart[:, feet].mean(1))
    assert errors["fingers"].min() > 1  # a larger hand
    wrist = turned(truth.pose, "right_wrist", (0.5, 0, 0))
    again = pose_errors(body, (wrist, SHAPE), foreign)
    torch.testing.assert_close(again["fingers"], errors["fingers"], atol=1e-3, rtol=0)


def test_the_predicted_region_holds_nine_of_ten_errors_of_its_covariance(body, truth):
    """Errors drawn with a covariance, which is then predicted right, too small, and too large."""
    draw = torch.randn(100, 3, generator=torch.Generator().manual_seed(0))
    still = truth.pose[[0] * 100]
    many = replace(truth, pose=still, cameras=[truth.cameras[0]] * 100)
    bent = turned(still, "left_elbow", (0.0, 0.0, 0.0))
    bent.rotations[:, JOINTS.index("left_elbow")] += 0.02 * draw
    apart = (body(bent, SHAPE).joints - body(still, SHAPE).joints).double()
    moved = apart[:, JOINTS.index("left_wrist")]
    covariance = moved.T @ moved / len(moved) + 1e-8 * torch.eye(3)
    shares = {}
    for factor in (0.1, 1.0, 10.0):
        C = (factor * covariance).expand(100, 55, 3, 3)
        shares[factor] = within_region(body, (bent, SHAPE), many, Uncertainty(C, C, {}))
        assert float(shares[factor]["hips", "in 90 % region"].min()) == 1  # they do not move
    wrists = [2 * float(shares[f]["wrists", "in 90 % region"].mean()) - 1 for f in shares]
    assert wrists[0] < 0.5 and 0.8 < wrists[1] < 0.97 and wrists[2] > 0.99, wrists
    rms, predicted = (shares[1.0]["joints", f"{name}rms, mm"] for name in ("", "predicted "))
    expected = 1e3 * covariance.trace().sqrt().expand(100)
    torch.testing.assert_close(predicted, expected)
    assert float(rms.mean()) < float(predicted.mean())  # one joint of 21 moves
