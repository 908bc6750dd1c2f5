"""Any number of workers gives the same bits."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import torch

from gva_mi.refine import SequenceOptions, SingleFrameOptions, refine
from gva_mi.refine.refine import refine_all

# Three frames in two clips of two, skimmed first.
CLIPS = SequenceOptions(size=48, passes=3, learn=1, part=2, overlap=0, skim=3)
SINGLE = SingleFrameOptions(size=64, passes=2)


def assert_same(some, others):
    for a, b in zip(some, others, strict=True):
        assert torch.equal(a.pose.rotations, b.pose.rotations)
        assert torch.equal(a.pose.transl, b.pose.transl)
        assert torch.equal(a.offsets, b.offsets) and a.kept == b.kept


@pytest.fixture(scope="module")
def alone(clip, coarse):
    """Two subjects, the second of two frames, refined by this process."""
    return list(refine_all([clip, shorter(clip)], coarse, CLIPS))


def shorter(clip):
    return replace(clip, pictures=clip.pictures[:2], pose=clip.pose[:2])


def test_clips_share_one_displacement_and_subjects_do_not_interact(alone, clip, coarse):
    refined = alone[0]
    assert refined.offsets.any() and not refined.kept
    assert (refined.losses < refined.losses_stage1).all()
    assert_same(alone[1:], [refine(shorter(clip), coarse, CLIPS)])


def test_a_clip_without_evidence_does_not_change_the_others(clip, coarse):
    """Not even the first one, from which the shared surface could have been taken."""
    gone = {0: "it has no picture", 1: "it has no mask"}
    pictures = [(np.zeros((96, 96), np.float32), None)] * 2 + clip.pictures[2:]
    options = replace(CLIPS, part=1)
    refined = refine(replace(clip, pictures=pictures, absent=gone), coarse, options)
    assert refined.kept == gone and refined.offsets.any()
    assert torch.equal(refined.pose.rotations[:2], clip.pose.rotations[:2])
    assert refined.losses[2] < refined.losses_stage1[2]


def test_single_frames_are_independent(clip, coarse):
    whole = refine(clip, coarse, SINGLE)
    first = refine(shorter(clip), coarse, SINGLE)
    assert torch.equal(first.pose.rotations, whole.pose.rotations[:2])


@pytest.mark.slow
def test_processes_that_share_frames_find_the_same_bits(clip, coarse, monkeypatch):
    """However soon the helper is ready; with close-ups, from the first inference on."""
    monkeypatch.setattr(import_module("gva_mi.refine.refine"), "SHARED_LOSSES", 1)
    monkeypatch.setattr("gva_mi.refine.sequence.STEPS_A_PASS", 1)
    options, calls = replace(CLIPS, part=120, passes=40, batch=3), []
    (one,) = refine_all([clip], coarse, options)
    (two,) = refine_all([clip], coarse, options, lambda *a, **figures: calls.append(a), workers=2)
    assert_same([one], [two])
    assert calls == sorted(calls) and calls[-1][0] == calls[-1][1]
