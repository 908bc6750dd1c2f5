"""What a frame is cut down to."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.pose.crop import NoEvidence
from gva_mi.pose.evidence import MaskAndNormals


@pytest.fixture
def frame(clip):
    return next(clip.frames())


@pytest.fixture(scope="module")
def points(body):
    return body(Pose.rest(1), Shape(torch.zeros(10))).vertices[0].detach()


def test_the_cut_holds_the_person_and_its_camera_agrees(frame, points):
    seen = MaskAndNormals.of(frame, 96, points)
    assert float(seen.mask.sum()) == pytest.approx(frame.mask.sum())
    shift = frame.camera.project(points.numpy()) - seen.camera.project(points.numpy())
    left, top = shift[0].round().astype(int)
    np.testing.assert_allclose(shift, shift[:1].repeat(len(shift), 0), atol=1e-6)
    rows, columns = seen.mask.shape
    assert (seen.camera.height, seen.camera.width) == (rows, columns)
    part = frame.mask[top : top + rows, left : left + columns]
    np.testing.assert_array_equal(seen.mask.numpy(), part)


def test_losses_vanish_at_the_target_itself_and_do_not_depend_on_its_size(frame, points):
    image = lambda t: torch.cat([t.normals, t.mask[..., None]], dim=-1)
    for size in (96, 48):
        seen = MaskAndNormals.of(frame, size, points)
        shown = image(seen)
        assert float(seen.silhouette_loss(shown)) == 0
        assert float(seen.normal_loss(shown)) == 0
        assert float(seen.silhouette_loss(torch.zeros_like(shown))) == pytest.approx(1, abs=1e-5)


def test_without_normals_their_loss_is_zero(frame, points):
    seen = MaskAndNormals.of(replace(frame, normals=None), 96, points)
    assert float(seen.normal_loss(torch.rand(*seen.mask.shape, 4))) == 0


def test_where_normals_are_missing_inside_the_mask_nothing_is_said(frame, points):
    """As beyond the edge of the crop that a network was shown."""
    cut = frame.normals.copy()
    cut[: len(cut) // 2] = 0
    seen = MaskAndNormals.of(replace(frame, normals=cut), 96, points)
    whole = MaskAndNormals.of(frame, 96, points)
    shown = torch.cat([whole.normals, whole.mask[..., None]], dim=-1)
    assert float(seen.normal_loss(shown)) == 0
    outside = shown + (whole.mask == 0)[..., None]
    assert float(seen.normal_loss(outside)) == float(whole.normal_loss(outside)) > 0


def test_frames_that_say_nothing_are_explained(frame, points):
    with pytest.raises(NoEvidence, match="empty"):
        MaskAndNormals.of(replace(frame, mask=np.zeros_like(frame.mask)), 96, points)
    with pytest.raises(NoEvidence, match="out of view"):
        MaskAndNormals.of(frame, 96, points + torch.tensor([20.0, 0, 0]))
    with pytest.raises(NoEvidence, match="behind the camera"):
        MaskAndNormals.of(frame, 96, points + torch.tensor([0, 0, 9.0]))
