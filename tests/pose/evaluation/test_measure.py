"""Means over frames: of all, of some, of poses under a camera that was found too."""

from dataclasses import replace

import pytest
import torch

from gva_mi.data.truth import Truth
from gva_mi.pose.evaluation.errors import pose_errors
from gva_mi.pose.evaluation.measure import Measured, measure
from gva_mi.pose.evaluation.record import _by_split
from gva_mi.pose.refine import Refined

SECONDS = 0.5


@pytest.fixture(scope="module")
def refined(clip, body, true_pose):
    """The truth, but in the last frame, which keeps stage 1."""
    rotations = true_pose.rotations.clone()
    rotations[2] = clip.pose.rotations[2]
    losses, offsets = torch.zeros(3), torch.zeros_like(body.v_template)
    pose = replace(true_pose, rotations=rotations)
    return Refined(pose, clip.shape, offsets, losses, losses, {}, [], SECONDS, held_out=[2])


@pytest.fixture(scope="module")
def measured(clip, body, true_pose, refined):
    truth = Truth(body, true_pose, clip.shape, clip.cameras)
    errors = [pose_errors(body, (p, clip.shape), truth) for p in (clip.pose, refined.pose)]
    iou = torch.tensor([0.5, torch.nan, 0.7])
    zeros = torch.zeros(3)
    return Measured(*errors, iou, iou + 0.1, iou + 0.2, None, SECONDS, zeros, zeros)


def test_frames_that_were_held_out_have_figures_of_their_own(measured, refined):
    splits = _by_split(measured, refined)["figures_by_split"]
    assert splits["train"]["vertex_mm"] == 0 < splits["test"]["vertex_mm"]
    assert splits["test"]["vertex_mm"] == splits["test"]["vertex_mm_stage1"]
    assert splits["test"]["iou"] == pytest.approx(0.8)
    assert measured.means.vertices.refined == pytest.approx(splits["test"]["vertex_mm"] / 3)
    assert _by_split(measured, replace(refined, held_out=[])) == {}


def test_a_frame_is_worse_where_its_error_grew(measured):
    swapped = replace(measured, stage1=measured.refined, refined=measured.stage1)
    assert measured.means.frames_worse == measured.means.frames_worse_hands == 0
    assert swapped.means.frames_worse == swapped.means.frames_worse_hands == pytest.approx(2 / 3)


def test_a_camera_that_was_found_is_judged_and_used(clip, body, true_pose, refined):
    long = [replace(c, fx=1.1 * c.fx, fy=1.1 * c.fy) for c in clip.cameras]
    truth = Truth(body, true_pose, clip.shape, clip.cameras)
    misled = replace(clip, camera=long[0])
    found = measure(misled, body, replace(refined, cameras=clip.cameras), truth).means
    assert found.focal.stage1 == pytest.approx(0.1) and found.focal.refined == 0
    assert found.iou_truth > 0.99
    left = measure(misled, body, refined, truth).means
    assert left.focal.refined == pytest.approx(0.1) and left.iou.refined < found.iou.refined
    assert any(line.startswith("focal") for line in left.lines())
