"""Close-ups show hands and feet at the video's own resolution."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape
from gva_mi.refine import close_ups as close_ups_module
from gva_mi.refine.close_ups import (
    HAND_ROBUST_SCALE,
    FinePicture,
    WeightedView,
    close_up_scale,
    close_ups,
    parts_of,
)
from gva_mi.refine.frame_losses import frame_loss
from gva_mi.refine.image_evidence import MaskAndNormals
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.subject.video import FrameWithoutPicture

SHAPE = Shape(torch.zeros(10))


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
    """The person's evidence at a third of the image's resolution, and the fine image."""
    with torch.no_grad():
        image = scene.render(vertices, fine).numpy()
    normals = lambda part: image[part][..., :3]
    outline = FrameWithoutPicture(0, image[..., 3], normals, fine, true_pose[1])
    return MaskAndNormals.of(outline, 1 / 3, vertices), FinePicture.of(outline, 1, vertices)


def test_a_close_up_contains_its_part_and_a_border(body, seen, vertices):
    (person, picture), parts = seen, dict.fromkeys(parts_of(body), 1.0)
    closer = close_ups(picture, parts, vertices, person)
    assert len(closer) == len(parts) == 4
    for part, (_, view) in zip(parts, closer, strict=True):
        points = vertices[part.vertices].double().numpy()
        pixels, T = view.camera.project(points), view.camera.T_camera_world
        depth = (points @ T[2, :3] + T[2, 3]).mean()
        mean_area = part.area / 4 * (view.camera.fx / depth) ** 2  # over all directions (Cauchy)
        assert view.area == pytest.approx(mean_area, rel=1e-6)
        length = np.ptp(pixels, 0).max()
        assert (pixels.min(0) > 0.2 * length).all()
        assert (pixels.max(0) < np.array([view.camera.width, view.camera.height])).all()
        assert view.mask.shape == view.normals.shape[:2] == (view.camera.height, view.camera.width)
        covered = float(view.mask.sum())  # with a piece of the arm or the leg
        assert 0.3 * view.area < covered < 4 * view.area


def test_a_hand_that_a_videos_mask_misses_hardly_pulls(body, scene, seen, vertices):
    """Its close-up's gradient falls by ``1 + r / c``; one that fits pulls as ever."""
    person, picture = seen
    hand = parts_of(body)[0]
    erased = picture.mask.clone()
    left, top = np.floor(picture.camera.project(vertices[hand.vertices].double().numpy()).min(0))
    right, bottom = np.ceil(picture.camera.project(vertices[hand.vertices].double().numpy()).max(0))
    erased[int(top) : int(bottom), int(left) : int(right)] = 0
    slope = {}
    for mask in (picture.mask, erased):
        for of_video in (False, True):
            given = replace(picture, mask=mask, normals=None, of_video=of_video)
            ((_, view),) = close_ups(given, {hand: 1.0}, vertices, person)
            x = (vertices + torch.tensor([0.004, 0, 0])).requires_grad_()
            image = scene.render(x, view.camera)
            off = float(view.silhouette_loss(image).detach())
            slope[off > 0.5, of_video] = torch.autograd.grad(view.loss(image, 1.0), x)[0]
            if of_video:
                plain = slope[off > 0.5, False]
                assert torch.allclose(
                    slope[off > 0.5, True], plain / (1 + off / HAND_ROBUST_SCALE), rtol=1e-4
                )
    assert slope[True, True].norm() < 0.2 * slope[True, False].norm()
    assert slope[False, True].norm() > 0.3 * slope[False, False].norm()


def test_parts_outside_the_image_have_no_close_up(body, seen, vertices):
    (person, picture), parts = seen, dict.fromkeys(parts_of(body), 1.0)
    far = vertices.clone()
    far[next(iter(parts)).vertices] += torch.tensor([4.0, 0, 0])
    assert len(close_ups(picture, parts, far, person)) == 3


def test_a_video_without_more_pixels_has_no_close_ups(body, fine, true_pose, monkeypatch):
    def scale(person, size):
        monkeypatch.setattr(close_ups_module, "HAND_PIXELS", size)
        return close_up_scale(body, true_pose, SHAPE, [fine] * 3, person)

    hand = fine.fx / 3 * parts_of(body)[0].length  # pixels, 3 m in front of the camera
    assert scale(0.5, round(2 * hand)) == 1
    assert scale(0.9, round(2 * hand)) is None
    assert scale(0.2, 10) == pytest.approx(10 / hand, rel=0.1)
    assert scale(0.9 * 10 / hand, 10) is None


def test_a_refinement_uses_close_ups(clip, coarse):
    options = SequenceOptions(size=30, faces=2000, passes=2, learn=1)
    ways = (replace(options, close_hands=weight) for weight in (0.0, 1.0))
    assert not torch.equal(*(refine(clip, coarse, way).pose.rotations for way in ways))


def test_a_frame_is_compared_only_where_mask_or_body_are(scene, seen, vertices):
    """Cutting off the rest of the picture changes neither the loss nor the gradient."""
    person = seen[0]
    moved = vertices + torch.tensor([0.05, 0.02, 0.0])
    part = person.around(moved)
    assert part.mask.numel() < 0.8 * person.mask.numel()
    found, gradient = frame_loss(scene, moved, [WeightedView(1.0, person)], 1.0, True)
    x = moved.clone().requires_grad_()
    loss = person.loss(scene.render(x, person.camera), 1.0)
    assert found == pytest.approx(float(loss.detach()), rel=1e-6)
    assert np.array_equal(gradient, torch.autograd.grad(loss, x)[0])
