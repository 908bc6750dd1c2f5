"""Boxes lie where the person and the hands are, the same for every avatar."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.evaluate.regions import (
    FACE_SIDE,
    HAND_SIDE,
    SMALLEST_REGION_SIDE,
    Details,
    box_around,
    person_box,
)
from gva_mi.splat import Camera, look_at


def test_the_persons_box_holds_the_mask_and_little_more():
    mask = np.zeros((100, 80), np.float32)
    mask[20:60, 30:50] = 1
    box = person_box(mask)
    assert (box.left, box.top, box.right, box.bottom) == (29, 19, 51, 61)


def test_a_tiny_persons_box_is_large_enough_for_the_networks_and_in_the_picture():
    mask = np.zeros((40, 40), np.float32)
    mask[39, 0] = 1
    box = person_box(mask)
    assert box.left == 0 and box.bottom == 40
    assert (
        SMALLEST_REGION_SIDE / 2 <= box.width <= SMALLEST_REGION_SIDE
        and SMALLEST_REGION_SIDE / 2 <= box.height <= SMALLEST_REGION_SIDE
    )


@pytest.fixture(scope="module")
def standing(body):
    """The built-in body in its T-pose, 200 pixels wide, seen from in front."""
    centre = np.array([0.0, 0.0, 0.0])
    camera = Camera(200, 200, 100, 100, look_at(centre + (0, 0, 3), centre), 200, 200)
    return Details(body, Pose.rest(), Shape(torch.zeros(10)), [camera])


def of(details, wanted):
    """The boxes of one kind in the only frame."""
    return [box for region, box in details.boxes(0) if region == wanted]


def test_both_hands_are_found_where_the_wrists_are(standing):
    boxes = of(standing, "hands")
    assert len(boxes) == 2
    joints = standing.body(standing.pose, standing.shape).joints[0].detach().double().numpy()
    for box, side in zip(boxes, ("left", "right"), strict=True):
        u, v = standing.cameras[0].project(joints[JOINTS.index(f"{side}_wrist")])
        assert box.left < u < box.right and box.top < v < box.bottom
        assert box.width == box.height == pytest.approx(200 * 0.28 / 3, abs=2)


def test_a_hand_behind_the_body_does_not_count(standing):
    """Seen from the side, one arm of a T-pose points at the camera and hides the other hand."""
    side = look_at(np.array([3.0, 0.4, 0.0]), np.array([0.0, 0.4, 0.0]))
    camera = replace(standing.cameras[0], T_camera_world=side)
    assert len(of(replace(standing, cameras=[camera]), "hands")) == 1


def test_the_face_is_found_between_jaw_and_eyes_from_before_and_not_from_behind(standing):
    (box,) = of(standing, "face")
    joints = standing.body(standing.pose, standing.shape).joints[0].detach().double().numpy()
    for name in ("jaw", "left_eye_smplhf", "right_eye_smplhf"):
        u, v = standing.cameras[0].project(joints[JOINTS.index(name)])
        assert box.left < u < box.right and box.top < v < box.bottom
    assert box.width == box.height == pytest.approx(200 * FACE_SIDE / 3, abs=2)
    behind = look_at(np.array([0.0, 0.0, -3.0]), np.zeros(3))
    turned = replace(standing.cameras[0], T_camera_world=behind)
    assert of(replace(standing, cameras=[turned]), "face") == []


def test_a_hand_at_the_edge_of_the_picture_or_behind_the_camera_has_no_box(standing):
    camera = standing.cameras[0]
    assert box_around(camera, np.array([[1.48, 0.0, 0.0]]), HAND_SIDE) is None
    assert box_around(camera, np.array([[0.0, 0.0, 5.0]]), HAND_SIDE) is None
    assert box_around(camera, np.array([[1.0, 0.0, 0.0]]), HAND_SIDE) is not None
