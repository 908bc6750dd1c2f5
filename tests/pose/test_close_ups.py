"""Hands and feet at the picture's own resolution."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.data.video import Outline
from gva_mi.pose.close_ups import CloseUps, FinePicture, close_up_scale, parts_of
from gva_mi.pose.evidence import MaskAndNormals, mean_loss
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions

SHAPE = Shape(torch.zeros(10))
ALIKE = {"hand": 1.0, "foot": 1.0}


@pytest.fixture(scope="module")
def fine(camera):
    """The camera at three times its resolution."""
    larger = {name: 3 * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, **larger, width=288, height=288)


@pytest.fixture(scope="module")
def vertices(body, true_pose):
    return body(true_pose[1], SHAPE).vertices[0].detach()


@pytest.fixture(scope="module")
def seen(scene, fine, vertices, true_pose):
    """The person's evidence at a third of the picture's resolution, and the fine picture."""
    with torch.no_grad():
        image = scene.render(vertices, fine).numpy()
    normals = lambda part: image[part][..., :3]
    outline = Outline(0, image[..., 3], normals, fine, true_pose[1])
    return MaskAndNormals.of(outline, 1 / 3, vertices), FinePicture.of(outline, 1, vertices)


def loss_of(scene, vertices, seen, body):
    person, picture = seen
    closer = CloseUps({0: picture}, body, ALIKE).of(0, vertices.detach(), person)
    whole = mean_loss(scene, vertices[None], [person], 1.0)
    return mean_loss(scene, vertices[None], [person], 1.0, [closer]) - whole


def test_a_close_up_holds_its_part_and_half_its_length_around(body, seen, vertices):
    person, picture = seen
    closer = CloseUps({0: picture}, body, ALIKE).of(0, vertices, person)
    parts = parts_of(body)
    assert len(closer) == len(parts) == 4
    for part, (_, view) in zip(parts, closer, strict=True):
        pixels = view.camera.project(vertices[part.vertices].double().numpy())
        length = np.ptp(pixels, 0).max()
        assert (pixels.min(0) > 0.2 * length).all()
        assert (pixels.max(0) < np.array([view.camera.width, view.camera.height])).all()
        assert view.mask.shape == view.normals.shape[:2] == (view.camera.height, view.camera.width)
        covered = float(view.mask.sum())  # with a piece of the arm or the leg
        assert 0.3 * view.area < covered < 4 * view.area


def test_hands_where_they_are_agree_with_their_close_ups(body, scene, seen, vertices, true_pose):
    """And an error of a wrist counts there for several times what it counts in the whole."""
    rotations = true_pose[1].rotations.clone()
    rotations[:, JOINTS.index("left_wrist"), 1] += 0.5
    moved = Pose(rotations, true_pose[1].transl, true_pose[1].expression)
    bent = body(moved, SHAPE).vertices[0].detach()
    person, picture = seen
    whole = [float(mean_loss(scene, x[None], [person], 1.0)) for x in (vertices, bent)]
    closer = [float(loss_of(scene, x, seen, body)) for x in (vertices, bent)]
    assert closer[0] < 0.2 * closer[1]
    assert closer[1] - closer[0] > 4 * (whole[1] - whole[0])


def test_their_loss_is_differentiated(body, scene, seen, vertices):
    """Moving all that is seen downhill makes it less."""
    x = (vertices + torch.tensor([0.013, 0.008, 0.0])).requires_grad_()
    (grad,) = torch.autograd.grad(loss_of(scene, x, seen, body), x)
    assert bool(grad.isfinite().all()) and float(grad.norm()) > 0
    downhill = x.detach() - 0.003 * grad.sum(0) / grad.sum(0).norm()
    assert float(loss_of(scene, downhill, seen, body)) < float(
        loss_of(scene, x.detach(), seen, body)
    )


def test_a_part_out_of_the_picture_has_no_close_up(body, seen, vertices):
    person, picture = seen
    far = vertices.clone()
    far[parts_of(body)[0].vertices] += torch.tensor([4.0, 0, 0])
    assert len(CloseUps({0: picture}, body, ALIKE).of(0, far, person)) == 3
    assert CloseUps({}, body, ALIKE).of(0, vertices, person) == []


def test_a_part_counts_by_its_weight(body, seen, vertices):
    person, picture = seen
    found = CloseUps({0: picture}, body, {"hand": 0.5, "foot": 0.0}).of(0, vertices, person)
    assert [weight for weight, _ in found] == [0.5, 0.5]


def test_a_video_without_more_pixels_has_none(body, fine, true_pose):
    scale = lambda person, size: close_up_scale(body, true_pose, SHAPE, [fine] * 3, person, size)
    hand = fine.fx / 3 * parts_of(body)[0].length  # pixels, 3 m before the camera
    assert scale(0.5, round(2 * hand)) == 1
    assert scale(0.9, round(2 * hand)) is None
    assert scale(0.2, 10) == pytest.approx(10 / hand, rel=0.1)
    assert close_up_scale(body, true_pose, SHAPE, [fine] * 3, 0.9 * 10 / hand, 10) is None


def test_a_refinement_looks_closer_where_it_is_asked_to(clip, body):
    options = SequenceOptions(size=40, passes=2, learn=1, close_feet=0)
    poses = [
        refine(clip, body, replace(options, close_hands=weight, hand_size=40)).pose.rotations
        for weight in (0.0, 1.0, 1.0)
    ]
    assert torch.equal(poses[1], poses[2]) and not torch.equal(poses[0], poses[1])
