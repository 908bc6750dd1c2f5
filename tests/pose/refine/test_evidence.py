"""How frames are cropped, and how masks and normals pull at a body."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.body.pose import Pose, Shape
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.refine.image_evidence import SILHOUETTE_ALONE, MaskAndNormals, common_scale
from gva_mi.splat import Camera, look_at
from gva_mi.subject.crop import mask_extent, points_extent


@pytest.fixture
def frame(clip):
    return next(clip.frames())


@pytest.fixture
def cut(outline_of):
    """The evidence of a frame at some scale."""
    return lambda frame, scale, points: MaskAndNormals.of(outline_of(frame), scale, points)


@pytest.fixture(scope="module")
def points(body):
    return body(Pose.rest(1), Shape(torch.zeros(10))).vertices[0].detach()


def shown(seen):
    """A rendering that agrees with the evidence."""
    return torch.cat([seen.normals, seen.mask[..., None]], dim=-1)


def test_the_crop_contains_the_person_and_its_camera_agrees(cut, frame, points):
    seen = cut(frame, 1, points)
    assert float(seen.mask.sum()) == pytest.approx(frame.mask.sum())
    shift = frame.camera.project(points.numpy()) - seen.camera.project(points.numpy())
    left, top = shift[0].round().astype(int)
    np.testing.assert_allclose(shift, shift[:1].repeat(len(shift), 0), atol=1e-6)
    rows, columns = seen.mask.shape
    assert (seen.camera.height, seen.camera.width) == (rows, columns)
    part = frame.mask[top : top + rows, left : left + columns]
    np.testing.assert_array_equal(seen.mask.numpy(), part)


def test_normals_are_compared_where_they_are_known(cut, frame, points):
    """Inside a mask they may be missing, too, as beyond the edge of a network's input."""
    half = frame.normals.copy()
    half[: len(half) // 2] = 0
    seen, whole = cut(replace(frame, normals=half), 1, points), cut(frame, 1, points)
    assert float(seen.normal_loss(shown(whole))) == 0
    hidden = shown(whole) * (torch.arange(len(whole.mask)) >= len(whole.mask) // 2)[:, None, None]
    assert float(seen.normal_loss(hidden)) == 0 < float(whole.normal_loss(hidden))


@pytest.mark.parametrize("scale", [1, 0.5, 0.37])
def test_losses_vanish_at_the_target_and_do_not_depend_on_its_size(scale, cut, frame, points):
    seen = cut(frame, scale, points)
    target = shown(seen)
    assert float(seen.silhouette_loss(target)) == float(seen.normal_loss(target)) == 0
    assert float(seen.silhouette_loss(0 * target)) == pytest.approx(1, abs=1e-5)


def test_beyond_the_mask_only_the_silhouette_is_compared(cut, frame, points):
    """So a part that a mask misses counts once."""
    seen = cut(frame, 1, points)
    beyond = shown(seen) + (seen.mask == 0)[..., None]
    assert float(seen.normal_loss(beyond)) == 0
    assert float(seen.loss(beyond, 2.0)) == 2 * float(seen.silhouette_loss(beyond)) > 0


def test_without_normals_the_silhouette_weighs_more(cut, frame, points):
    seen, blind = cut(frame, 1, points), cut(replace(frame, normals=None), 1, points)
    moved = shown(seen).roll(3, dims=1)
    alone = float(blind.loss(moved, 2.0))
    assert alone == pytest.approx(2 * SILHOUETTE_ALONE * float(seen.silhouette_loss(moved)))
    assert float(seen.silhouette_loss(moved)) < alone


def test_all_frames_have_the_scale_of_the_largest_person(clip, body):
    """Specks of a mask far from the person change nothing."""
    body_at = lambda outline: body(outline.pose, clip.shape).vertices[0]
    frames = range(len(clip))
    scale = common_scale(clip, frames, 40, body_at)
    longest = max(
        mask_extent(frame.mask)
        .joined(points_extent(body_at(frame).double().numpy(), frame.camera, ""))
        .longer
        for frame in clip.frames()
    )
    assert scale == pytest.approx(40 / longest, rel=0.03)
    assert common_scale(clip, frames, 200, body_at) == 1
    sprinkled = [(mask.copy(), normals) for mask, normals in clip.pictures]
    for mask, _ in sprinkled:
        mask[0, 0] = mask[-1, -1] = 1
    found = common_scale(replace(clip, pictures=sprinkled), frames, 40, body_at)
    assert found == pytest.approx(scale, rel=0.03)


def blurred(mask, width):
    kernel = torch.ones(1, 1, width, width) / width**2
    return torch.nn.functional.conv2d(mask[None, None], kernel, padding=width // 2)[0, 0]


def ball():
    """A sphere of radius 0.5: vertices (V, 3) and triangles (F, 3), closed and without seams."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    return torch.tensor(sphere.vertices).float(), torch.tensor(sphere.faces)


def fractions_of_the_slope(soften, between):
    """How strongly a sphere is pulled that is moved sideways from where its mask was rendered.

    Args:
        soften: changes the mask.
        between: range of the shifts, pixels.

    Returns:
        For the loss, and for squares in its place: the integral of the derivatives over the range,
        relative to the change of the loss. It is 1 if the derivatives are the true ones.
    """
    vertices, faces = ball()
    camera = Camera(240, 240, 36.3, 36.1, look_at((0.2, 0.1, 4), (0, 0, 0)), 72, 72)
    scene, right = MeshScene(faces, vertices), torch.tensor(camera.T_camera_world[0, :3]).float()
    pixel = 4 / camera.fx  # metres at the sphere's distance
    with torch.no_grad():
        mask = scene.render(vertices, camera)[..., 3]
    seen = MaskAndNormals(camera, soften(mask), None, float(mask.sum()))
    square_loss = lambda image: (image[..., 3] - seen.mask).square().sum() / seen.area
    shifts = torch.linspace(*between, 31)
    found = []
    for shift in shifts:
        moved = (vertices + shift * pixel * right).requires_grad_()
        image = scene.render(moved, camera)
        losses = [loss_of(image) for loss_of in (seen.silhouette_loss, square_loss)]
        pulls = [torch.autograd.grad(loss, moved, retain_graph=True)[0] for loss in losses]
        slopes = [pull.sum(0) @ right * pixel for pull in pulls]
        found.append([torch.stack(losses).detach(), torch.stack(slopes)])
    losses, slopes = (torch.stack(column) for column in zip(*found, strict=True))
    return (torch.trapezoid(slopes, shifts, dim=0) / (losses[-1] - losses[0])).tolist()


@pytest.mark.parametrize(
    ("soften", "between", "fraction"),
    [
        (lambda mask: mask, (0.5, 2.5), 0.5),
        (lambda mask: mask, (-6.0, -2.0), 0.5),
        (lambda mask: blurred(mask, 3), (2.0, 6.0), 0.5),
        (lambda mask: blurred(mask, 17), (1.0, 5.0), 0.0),
    ],
    ids=["hard mask, near", "hard mask, far", "beyond a soft edge", "within a soft edge"],
)
def test_the_loss_sees_half_the_slope_and_none_within_a_soft_edge(soften, between, fraction):
    """The outline's other half lies in pixels where both masks agree, where |x| has slope 0."""
    found, whole = fractions_of_the_slope(soften, between)
    assert found == pytest.approx(fraction, abs=0.04)
    assert whole == pytest.approx(1.0, abs=0.06)
