"""Landmarks as evidence: projected from known poses, they hold the body where it is seen."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Shape
from gva_mi.observe.face_points import FacePoints
from gva_mi.observe.rig import LandmarkRig
from gva_mi.refine.landmark_evidence import SeenLandmarks
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS, Landmarks, hand_names

NAMES = (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"))
SHAPE, HEAD = Shape(torch.zeros(10)), JOINTS.index("head")


def seen_of(body, pose, camera, names=NAMES):
    """Landmarks without errors, of a body in T poses."""
    rig = LandmarkRig.of(body, names)
    places = rig.places(body(pose, SHAPE).T_world_rest, SHAPE.betas, 0 * rig.rest).double()
    T = torch.tensor(camera.T_camera_world)
    metric = (places @ T[:3, :3].T + T[:3, 3]).numpy()
    pixels = np.stack([camera.project(points) for points in places.numpy()])
    ones = np.ones(pixels.shape[:2])
    return Landmarks(names, pixels, ones, 0 * ones, metric - metric[:, :1])


def loss_of(landmarks, body, pose, camera, offsets=None):
    seen = SeenLandmarks.of(landmarks, body, [camera] * len(pose), pose, SHAPE)
    offsets = torch.zeros_like(seen.rig.rest) if offsets is None else offsets
    return seen.losses(range(len(pose)), body(pose, SHAPE).T_world_rest, SHAPE, offsets).mean()


@pytest.fixture(scope="module")
def landmarks(body, true_pose, camera):
    return seen_of(body, true_pose, camera)


def test_the_true_pose_costs_nothing_and_a_turned_arm_does(body, true_pose, camera, landmarks):
    assert float(loss_of(landmarks, body, true_pose, camera)) == pytest.approx(0, abs=1e-4)
    turned = true_pose.rotations.clone()
    turned[:, JOINTS.index("left_elbow"), 1] += 0.3
    turned.requires_grad_()
    loss = loss_of(landmarks, body, replace(true_pose, rotations=turned), camera)
    loss.backward()
    assert float(loss.detach()) > 0.02
    assert (turned.grad[:, JOINTS.index("left_elbow"), 1] > 0).all()  # back


def test_offsets_explain_what_is_off_in_all_frames_at_a_cost(body, true_pose, camera, landmarks):
    seen = SeenLandmarks.of(landmarks, body, [camera] * len(true_pose), true_pose, SHAPE)
    offsets = torch.zeros_like(seen.rig.rest)
    offsets[seen.rig.names.index("left_hip")] = torch.tensor([0.0, 0.04, 0.0])
    assert float(loss_of(landmarks, body, true_pose, camera, offsets)) > 0.01
    offset_spread = float(seen.rig.offset_spread[seen.rig.names.index("left_hip")])
    assert float(seen.energy(offsets)) == pytest.approx((0.04 / offset_spread) ** 2 / 2)


def test_slopes_are_the_derivatives_of_the_errors_by_the_offsets(body, true_pose, camera):
    given = with_face(body, true_pose, camera)
    seen = SeenLandmarks.of(given, body, [camera] * len(true_pose), true_pose, SHAPE)
    frames, T_world_rest = [0, 2], body(true_pose[[0, 2]], SHAPE).T_world_rest
    offsets = torch.randn(seen.rig.rest.shape, generator=torch.Generator().manual_seed(0)) / 100
    errors = lambda o: seen.errors(frames, T_world_rest, SHAPE, o)
    found, step = seen.slopes(frames, T_world_rest, SHAPE, offsets), torch.full_like(offsets, 0.02)
    along = torch.autograd.functional.jvp(errors, offsets, step)[1]
    torch.testing.assert_close((found @ step[:, :, None])[..., 0], along, rtol=1e-3, atol=1e-5)
    other = step * torch.tensor([1.0, -2.0, 3.0])
    along = torch.autograd.functional.jvp(errors, offsets, other)[1]
    torch.testing.assert_close((found @ other[:, :, None])[..., 0], along, rtol=1e-3, atol=1e-5)


def test_a_landmark_that_is_not_known_pulls_at_nothing(body, true_pose, camera, landmarks):
    lost, at = replace(landmarks, pixels=landmarks.pixels.copy()), NAMES.index("left_wrist")
    lost.pixels[:, at] += 200
    far = float(loss_of(lost, body, true_pose, camera))
    lost.pixels[:, at] = np.nan
    assert far > 0.1 > 1e-4 > float(loss_of(lost, body, true_pose, camera))


def test_a_seen_face_tells_where_the_head_looks(body, true_pose, camera):
    """Its points cost a head that turns away; they tell nothing of one that faces away."""
    for facing, told in ((0.0, True), (torch.pi, False)):
        rotations = torch.zeros_like(true_pose.rotations)
        rotations[:, 0, 1] = facing
        pose, bent = replace(true_pose, rotations=rotations), rotations.clone()
        bent[:, HEAD, 1] = 0.1
        bent = replace(pose, rotations=bent)
        plain, both = seen_of(body, pose, camera), with_face(body, pose, camera)
        assert float(loss_of(both, body, pose, camera)) == pytest.approx(0, abs=1e-4)
        costs = [float(loss_of(given, body, bent, camera)) for given in (plain, both)]
        assert costs[1] > 4 * costs[0] if told else costs[1] == pytest.approx(costs[0], rel=1e-3)


def with_face(body, pose, camera):
    """The same landmarks with those of the face network."""
    plain, points = seen_of(body, pose, camera), FacePoints.of(body)
    T = body(pose, SHAPE).T_world_rest[:, [HEAD]]
    x = points.at_rest(SHAPE.betas.double()).float()
    places = ((T[..., :3, :3] @ x[..., None])[..., 0] + T[..., :3, 3]).double().numpy()
    pixels = np.stack([camera.project(frame) for frame in places])
    ones = np.ones(pixels.shape[:2])
    face = Landmarks(FACE_LANDMARKS, pixels, ones, 0 * ones, np.full(places.shape, np.nan))
    parts = ("pixels", "confidence", "spread", "metric")
    joined = (np.concatenate([getattr(x, name) for x in (plain, face)], 1) for name in parts)
    return Landmarks((*NAMES, *FACE_LANDMARKS), *joined)
