"""Untouched values keep their bits, joints turn about their own axes, browsers start as render."""

import math

import numpy as np
import roma
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.fit.renders import CameraPath, shots
from gva_mi.viewer.state import ShownPose, State, posed

KNEE, SHOULDER = JOINTS.index("left_knee"), JOINTS.index("left_shoulder")


def test_an_untouched_state_has_the_bits_of_the_frame(motion):
    for k in range(len(motion)):
        pose = posed(motion, State(frame=k, turned=((KNEE, (0.0, 0.0, 0.0)),), expression=(0.0,)))
        assert torch.equal(pose.rotations, motion[k].rotations)
        assert torch.equal(pose.expression, motion[k].expression)
        assert torch.equal(pose.transl, motion[k].transl)


def test_only_the_turned_joint_moves_about_its_own_axes(motion):
    """The motion turns the shoulder, too."""
    pose = posed(motion, State(frame=2, turned=((SHOULDER, (0.0, 30.0, 0.0)),)))
    before, after = (roma.rotvec_to_rotmat(x.rotations[0]) for x in (motion[2], pose))
    own = roma.rotvec_to_rotmat(torch.tensor([0, math.pi / 6, 0]))
    assert torch.allclose(after[SHOULDER], before[SHOULDER] @ own, atol=1e-6)
    others = [j for j in range(55) if j != SHOULDER]
    assert torch.equal(pose.rotations[:, others], motion[2].rotations[:, others])


def test_an_expression_is_added_and_may_be_longer(motion):
    few = motion.map(torch.clone)
    few.expression[:, 0] = 1.0
    added = (0.5, *[0.0] * 10, 2.0)  # 12, the motion has 10
    found = posed(few, State(expression=added)).expression
    assert found.shape == (1, 12) and found[0, 0] == 1.5 and found[0, 11] == 2.0


def test_the_surface_is_the_posed_body(body, known, motion, turning):
    pose = motion[2]
    pose.expression[0, :4] = torch.tensor([1.0, -1, 0.5, 2])
    pose.rotations[0, SHOULDER] = torch.tensor([0.3, -0.8, 0.2])
    truth = body(pose, turning(1)[1])
    found = ShownPose.of(known, pose)
    assert np.allclose(found.vertices, truth.vertices[0].numpy(), atol=2e-5)
    assert np.allclose(found.joints, truth.joints[0].numpy(), atol=2e-5)


def test_browsers_start_with_render_s_camera(known, motion, place, looking):
    usual = shots(CameraPath("static"), known.rig, motion)[0].camera
    camera = looking(place.position, usual.width, usual.height).to_camera()
    assert np.allclose(camera.T_camera_world, usual.T_camera_world, atol=1e-6)
    assert np.allclose(camera.K, usual.K)
    assert np.allclose(usual.project(place.look_at), (usual.cx, usual.cy), atol=1e-4)
