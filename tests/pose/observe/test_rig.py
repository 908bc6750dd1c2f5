"""Landmarks on the body: every name has a place, sides mirror, places follow joints and shape."""

import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape, mirrored_name
from gva_mi.core.errors import InputError
from gva_mi.observe.rig import LandmarkRig
from gva_mi.subject.landmarks import BODY_LANDMARKS, hand_names

EVERY = (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"))


@pytest.fixture(scope="module")
def rig(built_in_body):
    return LandmarkRig.of(built_in_body, EVERY)


def test_left_and_right_mirror_each_other(rig):
    other = [rig.names.index(mirrored_name(name)) for name in rig.names]
    flipped = rig.rest[other] * torch.tensor([-1.0, 1, 1])
    assert (rig.rest - flipped).norm(dim=1).max() < 0.004


def test_points_of_the_face_and_feet_lie_where_their_names_say(rig):
    at = dict(zip(rig.names, rig.rest, strict=True))
    assert at["nose"][2] > at["left_eye"][2] > at["left_ear"][2]
    assert at["left_ear"][0] > at["left_eye_outer"][0] > at["left_eye_inner"][0] > 0
    assert at["mouth_left"][1] < at["nose"][1] < at["left_eye"][1]
    assert at["left_foot_index"][2] > at["left_ankle"][2] > at["left_heel"][2]
    tip, knuckle = at["left_hand_index_tip"], at["left_hand_index_dip"]
    assert 0.01 < (tip - knuckle).norm() < 0.04


def test_unknown_names_are_left_out_and_order_is_kept(built_in_body, rig):
    some = LandmarkRig.of(built_in_body, ["right_knee", "tail", "nose"])
    assert some.names == ("right_knee", "nose")
    assert torch.equal(some.rest, rig.rest[[rig.names.index(name) for name in some.names]])


def test_names_of_which_none_is_known_are_refused(built_in_body):
    with pytest.raises(InputError, match="landmarks: expected names such as .*, got"):
        LandmarkRig.of(built_in_body, ("tail", "left_wing"))


def test_keypoints_lie_at_the_joints_themselves(built_in_body):
    """BlazePose's points lie off the joints; only the hips of keypoints may lie elsewhere."""
    names = [f"{side}_{limb}" for limb in ("hip", "knee", "ankle") for side in ("left", "right")]
    joints = built_in_body.j_template[[JOINTS.index(name) for name in names]]
    keypoints, landmarks = (LandmarkRig.of(built_in_body, names, some) for some in (names, ()))
    assert torch.equal(keypoints.rest, joints)
    assert ((landmarks.rest - joints).norm(dim=1) > 0.005).all()
    wider = keypoints.offset_spread / landmarks.offset_spread
    assert (wider[:2] >= 2).all() and (wider[2:] == 1).all()


def test_landmarks_that_are_joints_follow_pose_and_shape(built_in_body, rig):
    pose = Pose.rest(2)
    pose.rotations[1] = 0.3 * torch.randn(55, 3, generator=torch.Generator().manual_seed(1))
    shape = Shape(torch.tensor([1.0, -1, 0.5]))
    posed = built_in_body(pose, shape)
    places = rig.places(posed.T_world_rest, shape.betas, 0 * rig.rest)
    for name, joint in (("left_wrist", "left_wrist"), ("right_hand_ring_pip", "right_ring2")):
        apart = places[:, rig.names.index(name)] - posed.joints[:, JOINTS.index(joint)]
        assert apart.norm(dim=1).max() < 1e-5
