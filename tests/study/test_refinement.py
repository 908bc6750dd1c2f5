"""A refinement is measured frame by frame, written, and reported."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.data.pictures import write_image
from gva_mi.pose import SequenceOptions
from gva_mi.study.measure import Evaluation, PoseFigures, mask_iou, measure
from gva_mi.study.pose_tables import errors_table
from gva_mi.study.refinement import load_refinement, write_refinement


@pytest.fixture(scope="module")
def measured(estimated, body, refined, truth):
    return measure(estimated, body, refined, truth)


def test_frames_are_measured_one_by_one(measured):
    frames = measured.frames
    assert (frames["vertex_mm"][:5] == 0).all() and (
        frames["aligned_hand_vertex_mm"][:5] == 0
    ).all()
    assert frames["vertex_mm"][5] == frames["vertex_mm_stage1"][5] > 0
    assert (frames["hand_vertex_mm_stage1"] > frames["vertex_mm_stage1"]).all()  # arms are off
    torch.testing.assert_close(frames["iou"][:5], frames["iou_truth"][:5])
    assert frames["iou"].mean() > frames["iou_stage1"].mean()
    means = measured.means
    assert means["vertex_mm"] == pytest.approx(float(frames["vertex_mm"][5]) / 6)
    assert means.relative("body") == pytest.approx(-5 / 6, abs=0.02)
    assert means["points"] == "vertices"


def test_frames_whose_error_increased_are_counted(estimated, body, refined, truth):
    worse = replace(estimated, pose=refined.pose)  # found at stage 1, and lost again
    found = measure(worse, body, replace(refined, pose=estimated.pose), truth).means
    for name in ("frames_worse", "frames_worse_aligned", "frames_worse_hands"):
        assert found[name] == pytest.approx(5 / 6)


def test_figures_of_some_frames_are_those_frames(measured):
    assert measured.of([0, 1]).means["vertex_mm"] == 0
    last = measured.of([5]).means
    assert last["vertex_mm"] == last["vertex_mm_stage1"] > 0


def test_stage_1_alone_has_the_same_figures_and_no_refined_ones(measured, estimated, body, truth):
    alone = measure(estimated, body, None, truth).means
    before = {key: x for key, x in measured.means.to_json().items() if key.endswith("_stage1")}
    assert len(before) > 10 and {key: alone[key] for key in before} == before
    assert alone["vertex_mm"] is None and alone["frames_worse"] is None and alone["iou"] is None


def test_masks_are_compared_with_the_true_ones(estimated, tmp_path):
    shutil.copytree(estimated.folder, tmp_path, dirs_exist_ok=True)
    shutil.rmtree(tmp_path / "truth", ignore_errors=True)
    video = replace(estimated, folder=tmp_path)
    assert mask_iou(video) is None
    width, height = video.size
    for k, outline in enumerate(video.outlines(range(2))):
        wider = outline.mask if k == 0 else np.ones((height, width))
        write_image(tmp_path / f"truth/masks/{k:06d}.png", wider)
    share = next(video.outlines([1])).mask.mean()
    assert mask_iou(video) == pytest.approx((1 + share) / 2, abs=1e-3)


def test_a_frame_without_a_mask_has_no_iou(estimated, body, refined):
    lacking = replace(estimated, absent={1: "it has no mask"})
    found = measure(lacking, body, refined)
    assert found.frames["iou"].isnan().tolist() == [False, True] + 4 * [False]
    assert np.isfinite(found.means["iou"]) and found.means.change("body") is None


def test_the_silhouette_is_measured_through_the_lens_of_the_poses(estimated, body, refined, truth):
    short = [replace(c, fx=0.9 * c.fx, fy=0.9 * c.fy) for c in estimated.cameras]
    misled = replace(estimated, cameras=short)
    found = measure(misled, body, replace(refined, cameras=truth.cameras), truth).means
    assert measure(misled, body, refined, truth).means["iou"] < found["iou"]


def test_figures_come_back_from_json(measured, estimated, body, refined):
    for means in (measured.means, measure(estimated, body, refined).means, PoseFigures()):
        record = json.loads(json.dumps(means.to_json()))
        assert PoseFigures.from_json(record).to_json() == means.to_json()
    with pytest.raises(ValueError, match="'iou' is 'high'"):
        PoseFigures.from_json({"iou": "high"})


def test_the_record_holds_figures_by_split(estimated, body, refined, truth, tmp_path):
    shutil.copytree(estimated.folder, tmp_path, dirs_exist_ok=True)
    video = replace(estimated, folder=tmp_path)
    refined = replace(refined, held_out=[5])
    evaluation = Evaluation(video, body, SequenceOptions(), refined, truth)
    write_refinement(evaluation)
    record = json.loads((tmp_path / "refinement.json").read_text())
    splits = record["figures_by_split"]
    assert splits["train"]["vertex_mm"] == 0 < splits["test"]["vertex_mm"]
    assert record["kept"] == {"5": refined.kept[5]} and record["test_frames"] == "held out"
    assert (tmp_path / "refinement.png").exists() and (tmp_path / "poses_refined.npz").exists()
    figures, seen = load_refinement(tmp_path)
    assert figures == evaluation.measured.means and not seen
    assert load_refinement(tmp_path / "none") == (PoseFigures.from_json({}), True)
    (tmp_path / "refinement.json").write_text("[]")
    with pytest.raises(InputError, match="refinement.json: .*`gva-mi refine` writes"):
        load_refinement(tmp_path)


def test_trained_poses_have_a_column_beside_refined_ones():
    figures = PoseFigures({"vertex_mm_stage1": 20.0, "vertex_mm": 10.0, "ankle_depth_mm": 4.0,
                           "ankle_depth_mm_stage1": -5.0})  # fmt: skip
    table = errors_table(figures, {"body": 12.34, "feet_aligned": 5.0})
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["vertices, absolute, mm"] == ["20.0", "10.0", "-50 %", "12.3", "–"]
    assert rows["depth of the ankles, mm"] == ["-5.0", "+4.0", "+9.0", "–", "–"]
    assert rows["feet, pelvis-aligned, mm"] == ["–", "–", "–", "5.0", "–"]
