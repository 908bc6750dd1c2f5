"""Stage 2 finds poses that it was not told."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.data.truth import Truth
from gva_mi.pose import SequenceOptions, SingleFrameOptions, refine
from gva_mi.pose.evaluation.measure import measure

SEQUENCE = SequenceOptions(size=96)
PAPER = SingleFrameOptions(size=96, steps=14)


@pytest.fixture(scope="module")
def sequence(clip, body):
    return refine(clip, body, SEQUENCE)


@pytest.fixture(scope="module")
def paper(clip, body):
    return refine(clip, body, PAPER)


@pytest.mark.parametrize(("way", "left"), [("sequence", 0.55), ("paper", 0.7)])
def test_a_known_error_is_undone(request, clip, body, true_pose, way, left):
    refined = request.getfixturevalue(way)
    errors = measure(clip, body, refined, Truth(body, true_pose, clip.shape, clip.cameras)).means
    assert errors.vertices.refined < left * errors.vertices.stage1
    assert errors.iou.refined > errors.iou.stage1 and errors.iou_truth > 0.99
    assert (refined.losses < refined.losses_stage1).all() and not refined.kept


def test_the_same_call_gives_the_same_bits(clip, body):
    short = replace(SEQUENCE, passes=3)
    sequence, again = (refine(clip, body, short) for _ in range(2))
    assert torch.equal(again.pose.rotations, sequence.pose.rotations)
    assert torch.equal(again.pose.transl, sequence.pose.transl)
    assert torch.equal(again.offsets, sequence.offsets)


def test_the_order_of_frames_comes_from_the_seed(sequence, clip, body):
    other = refine(clip, body, replace(SEQUENCE, passes=3, seed=1))
    assert not torch.equal(other.pose.rotations, sequence.pose.rotations)


def test_the_paper_s_way_moves_rotations_alone(paper, clip):
    assert torch.equal(paper.pose.transl, clip.pose.transl)
    assert not paper.offsets.any()


def test_the_face_stays(sequence, clip):
    face = slice(22, 25)  # jaw and eyes
    after, before = sequence.pose, clip.pose
    torch.testing.assert_close(after.rotations[:, face], before.rotations[:, face])
    torch.testing.assert_close(after.expression, before.expression)


@pytest.mark.slow
def test_without_normals_the_silhouette_serves(clip, body, true_pose):
    blind = replace(clip, pictures=[(mask, None) for mask, _ in clip.pictures])
    refined = refine(blind, body, SEQUENCE)
    assert refined.without_normals == [0, 1, 2]
    errors = measure(blind, body, refined, Truth(body, true_pose, clip.shape, clip.cameras)).means
    assert errors.vertices.refined < 0.55 * errors.vertices.stage1


@pytest.mark.parametrize(
    "options", [replace(SEQUENCE, passes=2), replace(PAPER, steps=2)], ids=lambda o: o.name
)
def test_a_frame_without_a_person_keeps_its_pose(clip, body, options):
    pictures = list(clip.pictures)
    pictures[1] = (np.zeros_like(pictures[1][0]), pictures[1][1])
    refined = refine(replace(clip, pictures=pictures), body, options)
    assert "empty" in refined.kept[1]
    assert torch.equal(refined.pose.rotations[1], clip.pose.rotations[1])
    assert refined.losses[1].isnan()


def test_a_frame_that_got_worse_keeps_its_pose(clip, body):
    wild = replace(SEQUENCE, passes=2, largest_turn=9.0, step=9.0, translation_lr=0.0, cloth_lr=0.0)
    refined = refine(clip, body, wild)
    for k, reason in refined.kept.items():
        assert "grew" in reason
        assert torch.equal(refined.pose.rotations[k], clip.pose.rotations[k])
    assert refined.kept


def test_progress_counts_to_the_end(clip, body):
    calls = []
    refine(
        clip,
        body,
        replace(SEQUENCE, passes=2),
        lambda done, total, **f: calls.append((done, total, f)),
    )
    steps = 2 * 3 * 6  # a pass visits each of three frames six times
    assert [done for done, *_ in calls] == list(range(1, steps + 1))
    assert calls[-1][1] == steps and calls[-1][2]["loss"] > 0


def test_measures_of_the_truth_itself(clip, body, true_pose, sequence):
    perfect = replace(sequence, pose=true_pose, shape=clip.shape)
    errors = measure(clip, body, perfect, Truth(body, true_pose, clip.shape, clip.cameras)).means
    assert errors.vertices.refined == errors.hands.refined == errors.aligned.refined == 0
    assert errors.iou.refined == errors.iou_truth and errors.frames_worse == 0
    unknown = measure(clip, body, perfect).means
    assert unknown.vertices is None and unknown.iou_truth is None and unknown.iou == errors.iou


def test_wrong_options_are_refused():
    for options in (SequenceOptions, SingleFrameOptions):
        with pytest.raises(ValueError, match="refine: faces must be from 500 to 1,000,000, got 4"):
            options(faces=4)
    with pytest.raises(ValueError, match="passes must be from 1 to"):
        SequenceOptions(passes=0)
    with pytest.raises(ValueError, match="steps must be from 1 to"):
        SingleFrameOptions(steps=0)
    with pytest.raises(ValueError, match="skim must be from 1 to"):
        SequenceOptions(skim=0)
    for name in ("nat",):
        with pytest.raises(ValueError, match=f"{name} must be above 0"):
            SequenceOptions(**{name: 0.0})
