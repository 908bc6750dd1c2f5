"""A stretched body stands for another focal length."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.pose import Shape
from gva_mi.data.video import Frame
from gva_mi.pose.evidence.masks_normals import MaskAndNormals, mean_loss, seen_body
from gva_mi.pose.focal import brought_back, follow, stretched
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.splat import look_at

S = 1.2
SHAPE = Shape(torch.zeros(10))


@pytest.fixture(scope="module")
def vertices(body, true_pose):
    return body(true_pose, SHAPE).vertices.detach()


def test_a_stretched_body_looks_as_through_the_other_lens(scene, camera, vertices):
    wide = stretched(vertices, [camera] * 3, torch.tensor(S))[1]
    expected = scene.render(vertices[1], camera.zoomed(S))
    found = scene.render(wide.contiguous(), camera)
    assert float((found[..., 3] - expected[..., 3]).abs().mean()) < 1e-4
    normals = brought_back(found[..., :3], torch.tensor(S))
    error = float((normals - expected[..., :3]).abs().mean())
    assert error < 2e-4
    assert float((found - expected)[..., :3].abs().mean()) > 20 * error


def test_a_person_who_follows_keeps_the_size_in_the_image(body, camera, true_pose):
    moved = follow(true_pose, body.rest(SHAPE).joints[0], [camera] * 3, S)
    place = lambda pose, view: view.project(body(pose, SHAPE).joints[:, 0].double().numpy())
    np.testing.assert_allclose(place(moved, camera.zoomed(S)), place(true_pose, camera), atol=1e-3)
    tall = lambda pose, view: np.ptp(
        view.project(body(pose, SHAPE).vertices[0].double().numpy())[:, 1]
    )
    assert tall(moved, camera.zoomed(S)) == pytest.approx(tall(true_pose, camera), rel=0.02)
    assert tall(true_pose, camera.zoomed(S)) > 1.15 * tall(true_pose, camera)


@pytest.mark.parametrize("bad", [False, True], ids=["normals", "bad normals"])
def test_outlines_show_the_focal_length(body, scene, camera, true_pose, outline_of, bad):
    """Stage 1 took the focal length for a fifth too long, and the person for too far away."""
    pose, target = true_pose[0], np.array([0.0, -0.1, 0.0])
    near = replace(camera.zoomed(0.4), T_camera_world=look_at((0.3, 0.4, 1.3), target))
    with torch.no_grad():
        vertices = body(pose, SHAPE).vertices[0]
        image = scene.render(vertices, near).numpy()
    normals = image[..., :3] * np.float32([0.2, 0.2, 1.0]) if bad else image[..., :3]
    frame = Frame(0, image[..., :3], image[..., 3], normals, near.zoomed(S), pose)
    seen = MaskAndNormals.of(outline_of(frame), 1, vertices)
    far = follow(pose, body.rest(SHAPE).joints[0], [near], S)
    nothing = torch.zeros_like(body.v_template)

    def loss(s):
        outlines = seen_body(body, far, SHAPE, nothing, [seen], s)
        stretch = outlines.detach().requires_grad_()
        return mean_loss(scene, stretch, [seen], 1.0, focal=s.detach(), outlines=outlines)

    def slope(at):
        s = torch.tensor(at, requires_grad=True)
        return float(torch.autograd.grad(loss(s), s)[0])

    assert slope(0.9) > 0 and slope(1.0) > 0 and slope(0.7) < 0
    if not bad:
        losses = [float(loss(torch.tensor(x)).detach()) for x in (1 / S, 0.9, 1.0, 1.1)]
        assert losses[0] < 0.1 * losses[2] and losses == sorted(losses)


def test_bad_normals_do_not_favour_another_focal_length():
    """Stretching a frame's normals instead would scale all differences with s."""
    generator = torch.Generator().manual_seed(0)
    unit = lambda x: torch.nn.functional.normalize(x, dim=-1)
    true = unit(torch.randn(5000, 3, dtype=torch.float64, generator=generator))
    turned = roma.rotvec_to_rotmat(torch.tensor([0.1, -0.05, 0.15], dtype=torch.float64))
    for seen in (true @ turned, unit(true * torch.tensor([0.7, 0.7, 1.0]))):

        def loss(s, seen=seen):
            rendered = unit(true / torch.tensor([s, s, 1.0]))
            return float((brought_back(rendered, torch.tensor(s)) - seen).abs().mean())

        assert loss(1.0) > 0.03
        assert loss(1.1) == pytest.approx(loss(1.0), rel=1e-6)


def test_a_refinement_changes_the_focal_length_if_asked(clip, coarse):
    """Also if some frames have no normals."""
    (mask, _), *others = clip.pictures
    clip = replace(clip, pictures=[(mask, None), *others])
    options = SequenceOptions(passes=2, learn=1, size=48, faces=2000, refine_camera=True)
    refined = refine(clip, coarse, options)
    assert refined.focal != 1
    assert refined.cameras[0].fx == pytest.approx(refined.focal * clip.camera.fx)
