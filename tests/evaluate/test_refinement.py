"""A refinement is measured frame by frame, written, and reported."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.evaluate.figures import where
from gva_mi.evaluate.refinement import (
    MeasuredRefinement,
    describe,
    error_figures,
    joint_errors,
    kept_poses,
    load_refinement,
    load_uncertainty,
    mask_iou,
    means,
    measure,
    pose_tables,
    write_refinement,
)
from gva_mi.refine import SequenceOptions
from gva_mi.refine.uncertainty import Uncertainty
from gva_mi.subject.pictures import write_image

BODY, HANDS = ("body", "absolute"), ("hands", "absolute")


@pytest.fixture(scope="module")
def measured(estimated, body, refined, truth):
    return measure(estimated, body, refined, truth)


def value(figures, metric, part=("", "")):
    (found,) = where(figures, metric=metric, region=part[0], alignment=part[1])
    return found.value


def test_frames_are_measured_one_by_one(measured):
    before, after = (measured[*BODY, f"{stage} error, mm"] for stage in ("stage 1", "refined"))
    assert (after[:5] == 0).all() and after[5] == before[5] > 0
    assert (measured["hands", "pelvis-aligned", "refined error, mm"][:5] == 0).all()
    assert (measured[*HANDS, "stage 1 error, mm"] > before).all()  # arms are off
    iou, limit = measured["", "", "refined IoU"], measured["", "", "true IoU"]
    torch.testing.assert_close(iou[:5], limit[:5])
    assert iou.mean() > measured["", "", "stage 1 IoU"].mean()


def test_figures_are_means_over_frames_and_changes(measured):
    after = measured[*BODY, "refined error, mm"]
    figures = means(measured)
    assert value(figures, "refined error, mm", BODY) == pytest.approx(float(after[5]) / 6)
    assert value(figures, "change", BODY) == pytest.approx(-5 / 6, abs=0.02)
    assert value(figures, "IoU - limit") <= 0
    assert value(means(measured, [0, 1]), "refined error, mm", BODY) == 0
    assert value(means(measured, [5]), "change", BODY) == 0


def test_frames_whose_error_increased_are_counted(estimated, body, refined, truth):
    worse = replace(estimated, pose=refined.pose)  # found at stage 1, and lost again
    found = where(means(measure(worse, body, replace(refined, pose=estimated.pose), truth)),
        metric="increased")  # fmt: skip
    assert [figure.value for figure in found] == pytest.approx(3 * [5 / 6])


def test_stage_1_alone_has_the_same_figures_and_no_refined_ones(measured, estimated, body, truth):
    alone = measure(estimated, body, None, truth)
    assert len(alone) == 13 and all("refined" not in metric for *_, metric in alone)
    for key, values in alone.items():
        assert torch.equal(values, measured[key])


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
    assert found["", "", "refined IoU"].isnan().tolist() == [False, True] + 4 * [False]
    assert np.isfinite([figure.value for figure in means(found)]).all()
    assert {metric for *_, metric in found} == {"stage 1 IoU", "refined IoU"}  # no ground truth


def test_the_silhouette_is_measured_through_the_lens_of_the_poses(estimated, body, refined, truth):
    short = [replace(c, fx=0.9 * c.fx, fy=0.9 * c.fy) for c in estimated.cameras]
    misled = replace(estimated, cameras=short)
    right = replace(refined, cameras=truth.cameras)
    worse, better = (means(measure(misled, body, x, truth)) for x in (refined, right))
    assert value(worse, "refined IoU") < value(better, "refined IoU")


def test_the_record_holds_figures_by_split(estimated, body, refined, truth, tmp_path):
    shutil.copytree(estimated.folder, tmp_path, dirs_exist_ok=True)
    video = replace(estimated, folder=tmp_path)
    refined = replace(refined, held_out=[5])
    evaluation = MeasuredRefinement(video, body, SequenceOptions(), refined, truth)
    write_refinement(evaluation)
    record = json.loads((tmp_path / "refinement.json").read_text())
    assert record["kept"] == {"5": refined.kept[5]} and record["test_frames"] == "held out"
    assert record["points"] == "vertices"
    assert (tmp_path / "refinement.png").exists() and (tmp_path / "poses_refined.npz").exists()
    figures, seen = load_refinement(tmp_path)
    assert where(figures, split="") == evaluation.figures() and not seen
    of = {split: where(figures, split=split) for split in ("train", "test")}
    assert value(of["train"], "refined error, mm", BODY) == 0
    assert value(of["test"], "refined error, mm", BODY) > 0
    assert load_refinement(tmp_path / "none") == ((), True)
    (tmp_path / "refinement.json").write_text("[]")
    with pytest.raises(InputError, match="refinement.json: .*`gva-mi refine` writes"):
        load_refinement(tmp_path)


def test_the_uncertainty_lies_beside_the_poses_and_goes_too(estimated, body, refined, tmp_path):
    shutil.copytree(estimated.folder, tmp_path, dirs_exist_ok=True)
    video = replace(estimated, folder=tmp_path)
    covariances = 1e-4 * torch.eye(3).expand(6, 55, 3, 3).double()
    found = replace(refined, uncertainty=Uncertainty(covariances, 2 * covariances, {"mask": 1.0}))
    for one in (found, refined):
        measured = MeasuredRefinement(video, body, SequenceOptions(), one)
        write_refinement(measured)
        said = [line for line in describe(measured) if line.startswith("uncertain")]
        loaded = load_uncertainty(tmp_path)
        assert (loaded is None) == (one is refined) == (not said)
        if said:
            torch.testing.assert_close(loaded, 2 * covariances.float())
            expected = torch.full((55,), 1e3 * (3 * 2e-4) ** 0.5)
            torch.testing.assert_close(joint_errors(loaded), expected)
            assert "head 24" in said[0]
    np.savez(tmp_path / "uncertainty.npz", aligned=np.zeros((6, 54, 3, 3)))
    with pytest.raises(InputError, match="uncertainty.npz: 'aligned'"):
        load_uncertainty(tmp_path)


def test_trained_poses_have_a_column_beside_refined_ones(measured, estimated, body, truth):
    aside = estimated.pose.transl + torch.tensor([0.01, 0, 0])
    moved = replace(estimated.pose, transl=aside, rotations=truth.pose.rotations)
    trained = error_figures(body, (moved, estimated.shape), truth, "trained")
    found, *_ = pose_tables([*means(measured), *trained])
    column = found.head.index("trained error, mm")
    rows = {row[0]: row for row in found.rows}
    assert rows["body, absolute"][column] == "10.0"
    assert rows["body, pelvis-aligned"][column] == "0.0"
    assert rows["body, absolute"][found.head.index("change")] == "-83 %"


def test_frames_that_keep_a_pose_are_one_line(video):
    grew = {k: f"its loss grew from 1 to {k}" for k in (3, 2)}
    count, kept = len(video), {**grew, 1: "it has no mask"}
    (line,) = kept_poses(video, kept, "stage-1 pose")
    reasons = "1 (it has no mask), 2-3 (its loss grew)"
    assert line.endswith(f"3 of {count} frames keep their stage-1 poses: {reasons}")
    (line,) = kept_poses(video, {1: "it has no mask"}, "pose")
    assert line.endswith("frame 1 keeps its pose: it has no mask")
    assert not list(kept_poses(video, {}, "pose"))
