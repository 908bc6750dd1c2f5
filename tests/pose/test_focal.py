"""The focal length as an unknown: a stretched body instead of another lens."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape
from gva_mi.data.video import Frame
from gva_mi.pose.evidence import MaskAndNormals, mean_loss, seen_body
from gva_mi.pose.focal import follow, stretched, stretched_normals
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.splat import look_at

S = 1.2


@pytest.fixture(scope="module")
def vertices(body, true_pose):
    return body(true_pose, Shape(torch.zeros(10))).vertices.detach()


def test_a_stretched_body_looks_as_through_the_other_lens(scene, camera, vertices):
    longer = camera.zoomed(S)
    stretch = stretched(vertices, [camera] * 3, torch.tensor(S))
    for body, wide in zip(vertices, stretch, strict=True):
        truth = scene.render(body, longer)
        found = scene.render(wide.contiguous(), camera)
        assert float((found[..., 3] - truth[..., 3]).abs().mean()) < 1e-4
        expected = stretched_normals(truth[..., :3], torch.tensor(S))
        error = float((found[..., :3] - expected).abs().mean())
        assert error < 2e-4
        assert float((found - truth)[..., :3].abs().mean()) > 20 * error


def test_stretching_and_turning_back_are_differentiated(camera, vertices):
    points = vertices[:, ::400].double().requires_grad_()
    s = torch.tensor(S, dtype=torch.float64, requires_grad=True)
    normals = torch.randn(2, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x, k: stretched(x, [camera] * 3, k), (points, s))
    assert torch.autograd.gradcheck(stretched_normals, (normals, s))


def test_nothing_is_nowhere_stretched(camera, vertices):
    one = torch.tensor(1.0)
    torch.testing.assert_close(stretched(vertices, [camera] * 3, one), vertices)
    normals = torch.nn.functional.normalize(torch.randn(5, 3), dim=-1)
    torch.testing.assert_close(stretched_normals(normals, one), normals)
    assert not stretched_normals(torch.zeros(5, 3), torch.tensor(S)).any()


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


def test_the_evidence_says_which_lens_it_was(body, scene, camera, true_pose, outline_of):
    """Stage 1 took the focal length for a fifth too long, and the person for too far away."""
    shape, pose, target = Shape(torch.zeros(10)), true_pose[0], torch.tensor([0.0, -0.1, 0.0])
    near = replace(  # where a lens shows: arm's lengths make a difference
        camera.zoomed(0.4), T_camera_world=look_at((0.3, 0.4, 1.3), target.numpy())
    )
    with torch.no_grad():
        vertices = body(pose, shape).vertices[0]
        image = scene.render(vertices, near).numpy()
    frame = Frame(0, image[..., :3], image[..., 3], image[..., :3], near.zoomed(S), pose)
    seen = MaskAndNormals.of(outline_of(frame), 1, vertices)
    far = follow(pose, body.rest(shape).joints[0], [near], S)
    nothing = torch.zeros_like(body.v_template)

    def loss(s):
        stretch = seen_body(body, far, shape, nothing, [seen], s)
        return mean_loss(scene, stretch, [seen], 1.0, focal=s)

    s = torch.tensor(1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(s), s)
    assert float(slope) > 0
    with torch.no_grad():
        losses = [float(loss(torch.tensor(x))) for x in (1 / S, 0.9, 1.0, 1.1)]
    assert losses[0] < 0.1 * losses[2] and losses == sorted(losses)


def test_a_refinement_moves_the_lens_where_it_is_asked_to(clip, body):
    """Also where some frames have no normals."""
    options = SequenceOptions(passes=2, size=48)
    assert refine(clip, body, options).focal == 1
    asked = replace(options, refine_camera=True)
    (mask, _), *others = clip.pictures
    for pictures in (clip.pictures, [(mask, None), *others]):
        assert refine(replace(clip, pictures=pictures), body, asked).focal != 1
