"""The report of a refinement: it says what was measured, and what stands out."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.data.truth import Truth
from gva_mi.pose import SequenceOptions, SingleFrameOptions
from gva_mi.pose.evaluation.ablation import variants
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.measure import Evaluation, measure
from gva_mi.pose.evaluation.refinement_report import _worst, write_report
from gva_mi.pose.refine import Refined


@pytest.fixture(scope="module")
def refined(clip, body, true_pose):
    """As if the truth had been found in all frames but the last."""
    rotations = true_pose.rotations.clone()
    rotations[2] = clip.pose.rotations[2]
    pose = type(true_pose)(rotations, true_pose.transl, true_pose.expression)
    losses = torch.tensor([0.1, 0.2, float("nan")])
    kept = {2: "its loss grew from 0.100 to <0.200>"}
    offsets = torch.zeros_like(body.v_template)
    return Refined(pose, clip.shape, offsets, losses + 0.1, losses, kept, [1], 0.5)


def truth_of(clip, body, true_pose):
    return Truth(body, true_pose, clip.shape, clip.cameras)


@pytest.fixture(scope="module")
def measured(clip, body, true_pose, refined):
    return measure(clip, body, refined, truth_of(clip, body, true_pose))


def test_frames_are_measured_one_by_one(measured):
    assert measured.refined.body.shape == (3,)
    assert (measured.refined.body[:2] == 0).all() and (
        measured.refined.hands_aligned[:2] == 0
    ).all()
    torch.testing.assert_close(measured.refined.body[2], measured.stage1.body[2])
    assert (measured.stage1.hands > measured.stage1.body).all()  # the arms are off
    assert (measured.iou[:2] > measured.iou_stage1[:2]).all()
    torch.testing.assert_close(measured.iou[:2], measured.iou_truth[:2])


def test_a_frame_without_a_mask_has_no_iou(clip, body, refined):
    lacking = replace(clip, absent={1: "it has no mask"})
    found = measure(lacking, body, refined)
    assert found.iou.isnan().tolist() == [False, True, False]
    assert np.isfinite(found.means.iou.refined) and found.means.vertices is None


def test_what_is_known_is_not_measured_again(clip, body, true_pose, refined, measured):
    again = measure(clip, body, refined, truth_of(clip, body, true_pose), measured)
    assert again.stage1 is measured.stage1 and again.iou_stage1 is measured.iou_stage1
    assert torch.equal(again.refined.body, measured.refined.body)


def test_the_worst_frames_come_first(clip, measured):
    assert _worst(clip, measured)[0] == 2
    assert _worst(replace(clip, absent={2: "gone"}), measured)[0] != 2
    blind = replace(measured, refined=None, stage1=None, iou=torch.tensor([0.9, 0.3, torch.nan]))
    assert _worst(clip, blind)[:2] == [1, 0]


@pytest.mark.parametrize("known", [True, False], ids=["truth", "no truth"])
def test_the_page_says_it_all(tmp_path, clip, body, true_pose, refined, known):
    truth = truth_of(clip, body, true_pose) if known else None
    evaluation = Evaluation.of(Named(clip), body, SequenceOptions(), refined, truth)
    write_report(
        tmp_path / "page.html",
        evaluation,
        title="Poses of somebody",
        versions={"gva_mi": "1.2.3"},
        ablation={"no prior": evaluation.measured.means},
    )
    page = (tmp_path / "page.html").read_text()
    assert "its loss grew from 0.100 to &lt;0.200&gt;" in page  # escaped
    for sentence in ("Worst frames", "no prior", "silhouettes alone: 1.", "1.2.3", "passes"):
        assert sentence in page, sentence
    assert ("true pose" in page) and ("hands, mm" in page)
    assert ("Errors are distances" in page) is known
    assert page.count("data:image/webp") >= 6 and "http" not in page.split("</style>")[1]


class Named:
    """A clip with what a report asks of a Video besides."""

    def __init__(self, clip):
        self._clip = clip
        self.size = (96, 96)

    def __len__(self):
        return len(self._clip)

    def __getattr__(self, name):
        return getattr(self._clip, name)


def test_every_variant_changes_something_that_exists():
    for options in (SequenceOptions(), SingleFrameOptions()):
        varied = variants(options, {"another way": SingleFrameOptions(steps=3)})
        for variant in varied:
            assert variant.options != options or not variant.normals
        assert len({v.name for v in varied}) == len(varied)


def test_figures_come_back_from_json(measured, clip, body, refined):
    """Those of a video without truth too, and those of a folder that was never refined."""
    unknown = measure(clip, body, refined).means
    for means in (measured.means, unknown):
        record = json.loads(json.dumps(means.to_json()))
        assert PoseFigures.from_json(record) == means
    keys = {"vertex_mm_stage1", "hand_vertex_mm", "foot_vertex_mm", "aligned_vertex_mm", "iou"}
    assert keys <= set(unknown.to_json())
    assert set(PoseFigures.from_json({}).to_json().values()) == {None}
