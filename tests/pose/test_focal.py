"""The focal length as an unknown: a stretched body instead of another lens."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape
from gva_mi.pose.focal import follow, stretched, true_normals
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions

S = 1.2


@pytest.fixture(scope="module")
def vertices(body, true_pose):
    return body(true_pose, Shape(torch.zeros(10))).vertices.detach()


def test_a_stretched_body_looks_as_through_the_other_lens(scene, camera, vertices):
    longer = camera.zoomed(S)
    stretch = stretched(vertices, [camera] * 3, torch.tensor(S))
    for body, wide in zip(vertices, stretch, strict=True):
        truth = scene.render(body, longer)
        found = true_normals(scene.render(wide.contiguous(), camera), torch.tensor(S))
        assert float((found - truth).abs().mean()) < 1e-4
        raw = scene.render(wide.contiguous(), camera)  # with no turn back of the normals
        assert float((raw - truth).abs().mean()) > 20 * float((found - truth).abs().mean())


def test_stretching_and_turning_back_are_differentiated(camera, vertices):
    points = vertices[:, ::400].double().requires_grad_()
    s = torch.tensor(S, dtype=torch.float64, requires_grad=True)
    image = torch.randn(2, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x, k: stretched(x, [camera] * 3, k), (points, s))
    assert torch.autograd.gradcheck(true_normals, (image, s))


def test_nothing_is_nowhere_stretched(camera, vertices):
    one = torch.tensor(1.0)
    torch.testing.assert_close(stretched(vertices, [camera] * 3, one), vertices)
    image = torch.nn.functional.normalize(torch.randn(5, 3), dim=-1)
    image = torch.cat([image, torch.ones(5, 1)], -1)
    torch.testing.assert_close(true_normals(image, one), image)
    assert not true_normals(torch.zeros(5, 4), torch.tensor(S)).any()


def test_a_person_who_follows_keeps_the_size_in_the_picture(body, camera, true_pose):
    shape = Shape(torch.zeros(10))
    pelvis = body.rest(shape).joints[0]
    moved = follow(true_pose, pelvis, [camera] * 3, S)
    place = lambda pose, view: view.project(body(pose, shape).joints[:, 0].double().numpy())
    np.testing.assert_allclose(place(moved, camera.zoomed(S)), place(true_pose, camera), atol=1e-3)
    tall = lambda pose, view: np.ptp(
        view.project(body(pose, shape).vertices[0].double().numpy())[:, 1]
    )
    assert tall(moved, camera.zoomed(S)) == pytest.approx(tall(true_pose, camera), rel=0.02)
    assert tall(true_pose, camera.zoomed(S)) > 1.15 * tall(true_pose, camera)


def test_a_refinement_finds_the_sense_of_a_wrong_lens(clip, body):
    """Stage 1 took the focal length for a fifth too long, and the person for too far away."""
    wrong = clip.camera.zoomed(S)
    pelvis = body.rest(clip.shape).joints[0]
    far = follow(clip.pose, pelvis, clip.cameras, S)
    taken = type(clip)(far, clip.shape, clip.pictures, wrong)
    options = SequenceOptions(passes=30, size=96, refine_camera=True)
    refined = refine(taken, body, options)
    assert 0.8 < refined.focal < 0.99
    assert refine(taken, body, SequenceOptions(passes=2, size=96)).focal == 1
