"""What a frame is cut down to, and how its masks pull at a body."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.crop import NoEvidence, mask_extent, points_extent
from gva_mi.pose.evidence import ALONE, MaskAndNormals, common_scale
from gva_mi.splat import Camera, look_at


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


def test_the_cut_holds_the_person_and_its_camera_agrees(cut, frame, points):
    seen = cut(frame, 1, points)
    assert float(seen.mask.sum()) == pytest.approx(frame.mask.sum())
    shift = frame.camera.project(points.numpy()) - seen.camera.project(points.numpy())
    left, top = shift[0].round().astype(int)
    np.testing.assert_allclose(shift, shift[:1].repeat(len(shift), 0), atol=1e-6)
    rows, columns = seen.mask.shape
    assert (seen.camera.height, seen.camera.width) == (rows, columns)
    part = frame.mask[top : top + rows, left : left + columns]
    np.testing.assert_array_equal(seen.mask.numpy(), part)


def test_losses_vanish_at_the_target_itself_and_do_not_depend_on_its_size(cut, frame, points):
    image = lambda t: torch.cat([t.normals, t.mask[..., None]], dim=-1)
    for scale in (1, 0.5, 0.37):
        seen = cut(frame, scale, points)
        shown = image(seen)
        assert float(seen.silhouette_loss(shown)) == 0
        assert float(seen.normal_loss(shown)) == 0
        assert float(seen.silhouette_loss(torch.zeros_like(shown))) == pytest.approx(1, abs=1e-5)


def test_without_normals_their_loss_is_zero(cut, frame, points):
    seen = cut(replace(frame, normals=None), 1, points)
    assert float(seen.normal_loss(torch.rand(*seen.mask.shape, 4))) == 0


def test_where_normals_are_missing_inside_the_mask_nothing_is_said(cut, frame, points):
    """As beyond the edge of the crop that a network was shown."""
    half = frame.normals.copy()
    half[: len(half) // 2] = 0
    seen, whole = cut(replace(frame, normals=half), 1, points), cut(frame, 1, points)
    shown = torch.cat([whole.normals, whole.mask[..., None]], dim=-1)
    assert float(seen.normal_loss(shown)) == 0
    hidden = shown * (torch.arange(len(shown)) >= len(shown) // 2)[:, None, None]
    assert float(seen.normal_loss(hidden)) == 0 < float(whole.normal_loss(hidden))


def test_beyond_the_mask_the_silhouette_alone_is_compared(cut, frame, points):
    """So a mask that misses something counts once."""
    seen = cut(frame, 1, points)
    shown = torch.cat([seen.normals, seen.mask[..., None]], dim=-1)
    beyond = shown + (seen.mask == 0)[..., None]
    assert float(seen.normal_loss(beyond)) == 0
    assert float(seen.loss(beyond, 2.0)) == 2 * float(seen.silhouette_loss(beyond)) > 0


def test_without_normals_the_silhouette_counts_more(cut, frame, points):
    seen, blind = cut(frame, 1, points), cut(replace(frame, normals=None), 1, points)
    moved = torch.cat([seen.normals, seen.mask[..., None]], dim=-1).roll(3, dims=1)
    alone = float(blind.loss(moved, 2.0))
    assert alone == pytest.approx(2 * ALONE * float(seen.silhouette_loss(moved)))
    assert float(seen.silhouette_loss(moved)) < alone and float(blind.normal_loss(moved)) == 0


def test_frames_that_say_nothing_are_explained(cut, frame, points):
    with pytest.raises(NoEvidence, match="empty"):
        cut(replace(frame, mask=np.zeros_like(frame.mask)), 1, points)
    with pytest.raises(NoEvidence, match="out of view"):
        cut(frame, 1, points + torch.tensor([20.0, 0, 0]))
    with pytest.raises(NoEvidence, match="behind the camera"):
        cut(frame, 1, points + torch.tensor([0, 0, 9.0]))


def test_all_frames_have_the_scale_of_the_largest_person(clip, body):
    """And grains of a mask far from the person, or a body that stands too close, change nothing."""
    body_at = lambda outline: body(outline.pose, clip.shape).vertices[0]
    frames = range(len(clip))
    scale = common_scale(clip, frames, 40, body_at)
    longest = [
        mask_extent(frame.mask)
        .joined(points_extent(body_at(frame).double().numpy(), frame.camera, ""))
        .longer
        for frame in clip.frames()
    ]
    assert scale == pytest.approx(40 / max(longest), rel=0.03)
    assert common_scale(clip, frames, 200, body_at) == 1
    sprinkled = [(mask.copy(), normals) for mask, normals in clip.pictures]
    for mask, _ in sprinkled:
        mask[0, 0] = mask[-1, -1] = 1
    assert common_scale(replace(clip, pictures=sprinkled), frames, 40, body_at) == pytest.approx(
        scale, rel=0.03
    )


def blurred(mask, width):
    """Means over squares of some pixels."""
    kernel = torch.ones(1, 1, width, width) / width**2
    return torch.nn.functional.conv2d(mask[None, None], kernel, padding=width // 2)[0, 0]


def ball(rings=24):
    """A ball of radius 0.5: vertices (V, 3) and triangles (F, 3), closed and without seams."""
    polar, around = torch.meshgrid(
        torch.pi * torch.arange(1, rings) / rings,
        2 * torch.pi * torch.arange(2 * rings) / (2 * rings),
        indexing="ij",
    )
    places = [polar.sin() * around.cos(), polar.cos(), polar.sin() * around.sin()]
    vertices = torch.stack(places, -1).view(-1, 3)
    vertices = 0.5 * torch.cat([vertices, torch.tensor([[0.0, 1, 0], [0.0, -1, 0]])])
    k = torch.arange(2 * rings)
    here, there = k, (k + 1) % (2 * rings)
    faces = [torch.stack([here, torch.full_like(k, len(vertices) - 2), there], 1)]
    for ring in range(rings - 2):
        a, b = 2 * rings * ring, 2 * rings * (ring + 1)
        faces += [torch.stack([a + here, a + there, b + here], 1)]
        faces += [torch.stack([a + there, b + there, b + here], 1)]
    last = 2 * rings * (rings - 2)
    faces += [torch.stack([last + here, last + there, torch.full_like(k, len(vertices) - 1)], 1)]
    return vertices, torch.cat(faces)


def seen_of_the_slope(soften, between):
    """How a ball is pulled that is moved sideways from where its mask was taken.

    Args:
        soften: what is done to the mask.
        between: range of the shifts, pixels.

    Returns:
        By the program's loss, and by squares in its place: the integral of the derivatives over
        the range, as a part of how much the loss changes. It is 1 where they are the true ones.
    """
    vertices, faces = ball()
    camera = Camera(240, 240, 36.3, 36.1, look_at((0.2, 0.1, 4), (0, 0, 0)), 72, 72)
    scene, right = MeshScene(faces, vertices), torch.tensor(camera.T_camera_world[0, :3]).float()
    pixel = 4 / camera.fx  # metres at the ball's distance
    with torch.no_grad():
        mask = scene.render(vertices, camera)[..., 3]
    seen = MaskAndNormals(camera, soften(mask), None, float(mask.sum()))
    losses_of = (
        seen.silhouette_loss,
        lambda image: (image[..., 3] - seen.mask).square().sum() / seen.area,
    )
    shifts = torch.linspace(*between, 31)
    found = []
    for shift in shifts:
        moved = (vertices + shift * pixel * right).requires_grad_()
        image = scene.render(moved, camera)
        losses = [loss_of(image) for loss_of in losses_of]
        pulls = [torch.autograd.grad(loss, moved, retain_graph=True)[0] for loss in losses]
        slopes = [pull.sum(0) @ right * pixel for pull in pulls]
        found.append([torch.stack(losses).detach(), torch.stack(slopes)])
    losses, slopes = (torch.stack(column) for column in zip(*found, strict=True))
    return (torch.trapezoid(slopes, shifts, dim=0) / (losses[-1] - losses[0])).tolist()


@pytest.mark.parametrize("between", [(0.5, 2.5), (2.0, 6.0), (-6.0, -2.0)])
def test_of_hard_masks_the_loss_sees_half_the_slope_and_squares_see_all(between):
    """The outline's other half lies in pixels in which both masks agree, where |x| has slope 0."""
    half, whole = seen_of_the_slope(lambda mask: mask, between)
    assert half == pytest.approx(0.5, abs=0.03)
    assert whole == pytest.approx(2 * half, rel=1e-5)  # of 0 and 1 the square is the same number


def test_beyond_a_soft_edge_the_loss_sees_half_as_well():
    half, whole = seen_of_the_slope(lambda mask: blurred(mask, 3), (2.0, 6.0))
    assert half == pytest.approx(0.5, abs=0.03) and whole == pytest.approx(1.0, abs=0.04)


def test_within_a_soft_edge_the_loss_sees_nothing():
    nothing, whole = seen_of_the_slope(lambda mask: blurred(mask, 17), (1.0, 5.0))
    assert nothing == pytest.approx(0.0, abs=0.04) and whole == pytest.approx(1.0, abs=0.04)
