"""Stage 2 finds the true poses from masks and normals."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.face import face_shares
from gva_mi.body.pose import JAW_AND_EYES
from gva_mi.evaluate.refinement import measure
from gva_mi.refine import SequenceOptions, SingleFrameOptions, refine
from gva_mi.refine.close_ups import hand_vertices
from gva_mi.refine.observed_video import ObservedVideo, simplified_body
from gva_mi.refine.sequence import ClothedPerson, Solution
from gva_mi.subject.ground_truth import GroundTruth

SEQUENCE = SequenceOptions(size=96, faces=2000, passes=12, learn=5)
SHORT = replace(SEQUENCE, passes=1, learn=0)
PAPER = SingleFrameOptions(size=96, faces=2000, passes=14)


@pytest.fixture(scope="module")
def sequence(clip, body):
    return refine(clip, body, SEQUENCE)


BODY = ("body", "absolute")


@pytest.fixture(scope="module")
def paper(clip, body):
    return refine(clip, body, PAPER)


@pytest.mark.parametrize(("way", "left"), [("sequence", 0.55), ("paper", 0.7)])
def test_a_known_error_is_corrected(request, clip, body, true_pose, way, left):
    refined = request.getfixturevalue(way)
    truth = GroundTruth(body, true_pose, clip.shape, clip.cameras)
    found = measure(clip, body, refined, truth)
    mean = lambda *key: float(found[key].mean())
    before, after = (mean(*BODY, f"{x} error, mm") for x in ("stage 1", "refined"))
    assert after / before < left
    assert mean("", "", "refined IoU") > mean("", "", "stage 1 IoU")
    assert mean("", "", "true IoU") > 0.99
    assert (refined.losses < refined.losses_stage1).all() and not refined.kept
    assert refined.cameras is None


def test_the_result_depends_on_the_seed_alone(clip, coarse):
    first, again, other = (refine(clip, coarse, replace(SHORT, seed=s)) for s in (0, 0, 1))
    assert torch.equal(again.pose.rotations, first.pose.rotations)
    assert torch.equal(again.pose.transl, first.pose.transl)
    assert torch.equal(again.offsets, first.offsets)
    assert not torch.equal(other.pose.rotations, first.pose.rotations)


def test_hands_have_no_clothes_nor_has_a_face_that_only_masks_show(clip, coarse):
    hands = hand_vertices(coarse.weights)
    face = face_shares(coarse.rest(clip.shape), coarse.weights) == 1
    masks = replace(clip, pictures=[(mask, None) for mask, _ in clip.pictures])
    for seen, free in ((clip, True), (masks, False)):
        offsets = refine(seen, coarse, SHORT).offsets
        assert offsets.any() and hands.any() and not offsets[hands].any()
        assert face.any() and bool(offsets[face].any()) == free


def test_clips_of_a_long_video_keep_the_clothes_of_its_first_round(clip, coarse):
    """At the edge of the face, where D is a share, too."""
    masks = replace(clip, pictures=[(mask, None) for mask, _ in clip.pictures])
    video = ObservedVideo.of(masks, partial(simplified_body, coarse), SHORT)
    size = video.coarse.body.v_template.shape
    offsets = torch.randn(size, generator=torch.Generator().manual_seed(0))
    part = video.clip(range(len(clip)), 0, clip.pose)
    first = Solution(clip.pose, clip.shape, offsets)
    assert not ClothedPerson(part, SHORT).offsets.any()
    assert torch.equal(ClothedPerson(replace(part, first_round=first), SHORT).offsets, offsets)


def test_what_is_not_refined_stays(sequence, paper, clip):
    """The face, and all but rotations in Eq. 8 as printed."""
    before = clip.pose.rotations[:, JAW_AND_EYES]
    torch.testing.assert_close(sequence.pose.rotations[:, JAW_AND_EYES], before)
    torch.testing.assert_close(sequence.pose.expression, clip.pose.expression)
    assert torch.equal(paper.pose.transl, clip.pose.transl) and not paper.offsets.any()


@pytest.mark.slow
def test_without_normals_the_silhouette_suffices(clip, seen_in, turning, body):
    """A person who turns, whose joints are off by 0.1 rad for some frames."""
    from scipy.ndimage import gaussian_filter1d

    true, shape = turning(24)
    errors = gaussian_filter1d(np.random.default_rng(0).normal(size=(104, 21, 3)), 3, axis=0)
    errors = torch.from_numpy(0.1 * errors / errors.std())[40:-40].float()
    rotations = true.rotations.clone()
    rotations[:, 1:22] = roma.rotvec_composition([rotations[:, 1:22], errors])
    masks = [(mask, None) for mask, _ in seen_in(true)]
    blind = replace(clip, pose=replace(true, rotations=rotations), pictures=masks)
    refined = refine(blind, body, SEQUENCE)
    assert refined.without_normals == list(range(24))
    found = measure(blind, body, refined, GroundTruth(body, true, shape, blind.cameras))
    before, after = (found[*BODY, f"{x} error, mm"].mean() for x in ("stage 1", "refined"))
    assert after / before < 0.55


@pytest.mark.parametrize("options", [SHORT, replace(PAPER, passes=2)], ids=lambda o: o.name)
def test_a_frame_without_a_person_keeps_its_pose(clip, coarse, options):
    pictures = list(clip.pictures)
    pictures[1] = (np.zeros_like(pictures[1][0]), pictures[1][1])
    refined = refine(replace(clip, pictures=pictures), coarse, options)
    assert "empty" in refined.kept[1]
    assert torch.equal(refined.pose.rotations[1], clip.pose.rotations[1])
    assert refined.losses[1].isnan()


def test_held_out_frames_follow_the_motion_whatever_their_images_show(clip, coarse):
    options = replace(SHORT, hold_out_test=True)
    held = replace(clip, splits=SimpleNamespace(test=[1]))
    pictures = [clip.pictures[0], clip.pictures[2], clip.pictures[2]]
    first, other = (
        refine(video, coarse, options) for video in (held, replace(held, pictures=pictures))
    )
    assert first.held_out == [1] and first.losses[1].isnan() and not first.kept
    assert not torch.equal(first.pose.rotations[1], clip.pose.rotations[1])
    assert torch.equal(first.pose.rotations, other.pose.rotations)


def test_a_frame_whose_loss_grew_keeps_its_pose(clip, coarse):
    wild = replace(SHORT, largest_turn=9.0, step=9.0, translation_lr=0.0)
    calls = []
    refined = refine(clip, coarse, wild, lambda done, total, **figures: calls.append((done, total)))
    for k, reason in refined.kept.items():
        assert "grew" in reason
        assert torch.equal(refined.pose.rotations[k], clip.pose.rotations[k])
    assert refined.kept
    steps = 3 * 6  # a pass visits each of three frames six times
    assert calls == [(step, steps) for step in range(1, steps + 1)]
