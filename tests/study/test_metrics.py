"""``metrics.json``: what is written is read again, and what is not known is not invented."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from gva_mi.body.pose import Pose, save_poses
from gva_mi.core.errors import InputError
from gva_mi.data.cameras import save_cameras
from gva_mi.data.normals import NormalMaps
from gva_mi.data.video import load_video
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.run_folder import METRICS
from gva_mi.study.evaluate import SplitScores
from gva_mi.study.measure import PoseFigures
from gva_mi.study.metrics import (
    Metrics,
    PoseFit,
    Training,
    _pose_errors,
    load_metrics,
    protocol_of,
    save_metrics,
)
from gva_mi.study.scores import Scorer
from gva_mi.study.surface import SurfaceFigures

FIGURES = PoseFigures.from_json({
    "vertex_mm_stage1": 0.25, "vertex_mm": 1.25, "hand_vertex_mm_stage1": 2.25,
    "hand_vertex_mm": 3.25, "finger_mm_stage1": 8.25, "finger_mm": 9.25,
    "ankle_depth_mm_stage1": -2.0, "ankle_depth_mm": 3.0, "wrist_depth_mm_stage1": 4.0,
    "wrist_depth_mm": -5.0, "frames_worse": 0.1, "frames_worse_hands": 0.2, "points": "vertices",
    "iou_stage1": 0.5, "iou": 0.75, "iou_truth": 0.9, "seconds_per_frame": 1.5,
})  # fmt: skip
UNKNOWN = PoseFigures.from_json({})


@pytest.fixture
def metrics():
    return Metrics(
        rows=(
            SplitScores("full", "test", 30.125, 0.98, None, 0.03),
            SplitScores("poses as refined", "test", 29.5, 0.97, 0.1, 0.04),
        ),
        refinement=FIGURES,
        training=Training(steps=3, seconds=1.5, gaussians=400, size=(48, 32)),
        options={"seed": 7, "steps": 3},
        versions={"python": "3.11"},
    )


def test_metrics_survive_a_round_trip(metrics, tmp_path):
    fitted = replace(metrics, pose_fit=PoseFit({"passes": 2}, {"3": "it has no mask"}, 0.5))
    known = replace(
        metrics,
        protocol={"seen": {"test pictures": ["stage 1"]}},
        similarity={"scale": 1.03, "turn_degrees": 0.5, "shift_m": 0.2},
        surface=(SurfaceFigures(500, "before", 900, {"stray, mm": 0.5}),),
        poses_mm={"given": {"body_aligned": 12.5}, "trained": {"body_aligned": 10.0}},
    )
    for some in (metrics, fitted, known, replace(metrics, refinement=UNKNOWN)):
        save_metrics(tmp_path, some)
        assert load_metrics(tmp_path) == some


def test_the_keys_of_the_file_do_not_change(metrics):
    record = metrics.to_json()
    assert list(record) == [
        "rows", "refinement", "training", "protocol", "similarity", "surface", "poses_mm",
        "options", "versions", "seed",
    ]  # fmt: skip
    assert list(record["rows"][0]) == [
        "name", "split", "psnr", "ssim", "lpips", "rand_vgg", "region", "count",
    ]  # fmt: skip
    assert set(record["refinement"]) >= {
        "vertex_mm_stage1", "vertex_mm", "hand_vertex_mm_stage1", "hand_vertex_mm",
        "foot_vertex_mm_stage1", "foot_vertex_mm", "aligned_vertex_mm_stage1", "aligned_vertex_mm",
        "frames_worse", "frames_worse_aligned", "frames_worse_hands", "iou_stage1", "iou",
        "iou_truth", "seconds_per_frame",
    }  # fmt: skip
    assert list(record["training"]) == ["steps", "seconds", "gaussians", "size"]
    assert json.loads(json.dumps(record))["training"]["size"] == [48, 32]
    fitted = replace(metrics, pose_fit=PoseFit({}, {}, 0.5)).to_json()
    assert list(fitted)[-1] == "pose_fit"


def test_trained_poses_have_a_line_of_their_own(metrics):
    errors = {
        "given": {"body": 54.25, "body_aligned": 15.0, "feet": 70.0},
        "trained": {"body": 61.0, "body_aligned": 13.5, "feet": 74.0},
    }
    lines = list(replace(metrics, poses_mm=errors).lines())
    assert "trained, aligned: body 15.0 → 13.5 mm" in lines
    assert "trained, absolute: body 54.2 → 61.0, feet 70.0 → 74.0 mm" in lines
    assert not any(line.startswith("trained") for line in metrics.lines())


@pytest.mark.parametrize(
    "poses, refinement, seen",
    [
        ("poses.npz", None, (["stage 1"], [], [])),
        ("poses_refined.npz", None, (["stage 1"], ["refine"], ["refine"])),
        ("poses_refined.npz", "seen", (["stage 1"], ["refine"], ["refine"])),
        ("poses_refined.npz", "held out", (["stage 1"], [], [])),
        ("poses_photometric.npz", None, (["stage 1", "track"], ["track"], [])),
    ],
)
def test_the_protocol_lists_who_has_seen_the_test_frames(poses, refinement, seen, video, tmp_path):
    if refinement is not None:
        (tmp_path / "refinement.json").write_text(
            json.dumps({"figures": {}, "test_frames": refinement})
        )
    video = replace(video, normals=NormalMaps(tmp_path, "perspective", None))
    options = {"vgg16": None}
    found = protocol_of(Scorer(Weights()), video, tmp_path / poses, options)
    assert tuple(found["seen"].values()) == seen and found["masks"] == "the video's"
    assert found["training_loss"] == "rand_vgg" and found["networks"]["lpips"] is None
    ours = protocol_of(Scorer(Weights()), video, tmp_path / poses, {"vgg16": "my.pth"})
    assert ours["training_loss"] == "VGG16, my.pth"


def test_errors_of_given_and_of_trained_poses_are_reported(studio, body, tmp_path):
    folder = tmp_path / "known"
    shutil.copytree(studio.folder, folder)
    save_poses(folder / "truth/poses.npz", studio.pose, studio.shape, stage=0)
    save_cameras(folder / "truth/cameras.npz", studio.cameras)
    video = load_video(folder)
    aside = video.pose.transl + torch.tensor([0.01, 0, 0])
    moved = Pose(video.pose.rotations, aside, video.pose.expression)
    found = _pose_errors(video, replace(video, pose=moved), body)
    assert list(found) == ["given", "trained"]
    assert found["given"]["body"] == pytest.approx(0, abs=1e-4)
    assert found["trained"]["body"] == pytest.approx(10, abs=1e-3)
    assert found["trained"]["body_aligned"] == pytest.approx(0, abs=1e-3)
    assert _pose_errors(video, video, body) == {}  # nothing was trained
    assert _pose_errors(studio, replace(studio, pose=moved), body) == {}  # nothing is known


@pytest.mark.parametrize("text", [None, "{", "[]", '{"rows": []}'])
def test_a_file_that_cannot_be_read_is_named(text, tmp_path):
    if text is not None:
        (tmp_path / METRICS).write_text(text)
    with pytest.raises(
        InputError, match="metrics.json: .*; expected what `gva-mi evaluate` writes"
    ):
        load_metrics(tmp_path)
