"""An avatar's figures are of the frames and pixels that they are named after; files keep them."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gva_mi.body.pose import Pose
from gva_mi.core.errors import InputError
from gva_mi.evaluate.figures import Figure, where
from gva_mi.evaluate.measure import (
    Metrics,
    evaluate,
    evaluate_views,
    protocol_of,
    views_of,
    with_trained_poses,
)
from gva_mi.evaluate.scores import PSNR_MAX, Scorer
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.renders import render_frame
from gva_mi.fit.run_folder import METRICS
from gva_mi.splat import look_at
from gva_mi.subject.crop import Box
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.normals import NormalMaps
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

NONE = Weights()  # whatever this machine has


def psnr(figures):
    """PSNR by split and region."""
    return {(f.split, f.region): f.value for f in where(figures, metric="PSNR, dB")}


def test_the_avatar_that_made_the_pictures_reaches_the_maximum(known, studio, body):
    rows = evaluate(known, studio, weights=NONE, body=body)
    assert {row.region for row in rows} == {"white", "person", "hands"}
    whole = where(rows, region="white")
    found = {(row.split, row.metric): row.value for row in whole}
    for split, pictures in (("train", 1), ("test", 1), ("novel_pose", 2)):
        assert found.pop((split, "pictures")) == pictures
        assert found.pop((split, "SSIM")) == pytest.approx(1)
        for metric, value in (("PSNR, dB", PSNR_MAX), ("LPIPS", None), ("rand_vgg", 0)):
            assert found.pop((split, metric)) == value
    assert not found


def test_a_held_out_range_has_rows_of_its_own(studio):
    splits = replace(studio.splits, held_out_range=studio.splits.test)
    views = {view.split: list(view.frames) for view in views_of(replace(studio, splits=splits))}
    assert views["held_out_range"] == splits.test and "test" not in views


def test_figures_are_taken_in_the_boxes_of_hands_and_face(known, studio):
    """Of a picture that is wrong in the face's box alone, no other detail has a worse figure."""
    hand, face = Box(0, 0, 16, 16), Box(24, 24, 40, 40)
    details = SimpleNamespace(boxes=lambda _: iter([("hands", hand), ("face", face)]))
    (view,) = views_of(studio, ("train",))

    class Marked:
        """The same frames, with a spot in the face's box."""

        def __getattr__(self, name):
            return getattr(view.video, name)

        def frames(self, numbers):
            for frame in view.video.frames(numbers):
                image = frame.image.copy()
                face.cut(image)[4:8, 4:8] = 1 - face.cut(image)[4:8, 4:8].round()
                yield replace(frame, image=image)

    marked = replace(view, video=Marked(), details=details)
    figures = evaluate_views(known, [marked], Scorer(NONE))
    found = {region: x for (_, region), x in psnr(figures).items()}
    assert found["face"] < found["white"] < PSNR_MAX == found["hands"]
    assert [f.value for f in where(figures, metric="pictures", region=("hands", "face"))] == [1, 1]


@pytest.fixture
def watched(studio, known, camera, tmp_path):
    """The studio's subject with what a second camera saw of its two frames, and no truth."""
    folder = tmp_path / "watched"
    shutil.copytree(studio.folder, folder)
    shutil.rmtree(folder / "truth")
    T = look_at(camera.position + (0.3, 0.1, 0.0), (0.0, 0.0, 0.0))
    other = camera.with_matrices(T_camera_world=T)
    writer = SubjectWriter(folder)
    for k, frame in enumerate((1, 0)):
        picture = render_frame(known, studio.pose[frame], other)
        writer.views.frame(k, picture)
        writer.views.mask(k, np.ones(picture.shape[:2]))
    writer.views.cameras([other] * 2)
    writer.views_record([1, 0], ["b", "b"])
    return folder


def test_pictures_of_other_cameras_are_novel_views(known, watched, body):
    video = load_video(watched)
    whole = where(evaluate(known, video, weights=NONE, body=body), region="white")
    assert {row.split for row in whole} == {"train", "test", "novel_view"}
    assert psnr(whole)["novel_view", "white"] == PSNR_MAX
    assert [f.value for f in where(whole, split="novel_view", metric="pictures")] == [2]


def test_views_of_other_cameras_use_the_trained_poses(known, watched):
    """Poses that are off by a centimetre before training: the trained ones count."""
    video = load_video(watched)
    off = replace(video, pose=Pose(video.pose.rotations, video.pose.transl + 0.01,
                                   video.pose.expression))  # fmt: skip
    given = {view.split: view for view in views_of(off)}
    trained = [with_trained_poses(view, video) for view in given.values()]
    before, after = (
        psnr(where(evaluate_views(known, views, Scorer(NONE)), region="white")).values()
        for views in (list(given.values()), trained)
    )
    assert max(before) < 45 and set(after) == {PSNR_MAX}


def test_ground_truth_masks_are_preferred(known, subject, tmp_path):
    folder = tmp_path / "subject"
    shutil.copytree(subject, folder)
    masks = folder / "masks"
    shutil.copytree(masks, folder / "truth/masks")
    for path in masks.iterdir():
        write_image(path, np.ones((48, 48)))  # a segmenter that leaves the wall in
    with_truth = evaluate(known, load_video(folder), splits=["test"], weights=NONE)
    assert with_truth == evaluate(known, load_video(subject), splits=["test"], weights=NONE)
    shutil.rmtree(folder / "truth")
    without = evaluate(known, load_video(folder), splits=["test"], weights=NONE)
    assert psnr(without)["test", "white"] < psnr(with_truth)["test", "white"]


def test_metrics_survive_a_round_trip(tmp_path):
    figures = (Figure(split="test", region="white", metric="PSNR, dB", value=30.125),
        Figure(split="test", region="white", metric="LPIPS", value=None),
        Figure(metric="seconds", value=1.5))  # fmt: skip
    metrics = Metrics(figures=figures, size=(48, 32),
        protocol={"seen": {"test pictures": ["stage 1"]}}, options={"seed": 7, "steps": 3},
        versions={"python": "3.11"})  # fmt: skip
    metrics.save(tmp_path)
    assert Metrics.load(tmp_path) == metrics
    record = json.loads((tmp_path / METRICS).read_text())
    assert list(record) == ["figures", "size", "protocol", "options", "versions"]
    assert list(record["figures"][0]) == [
        "subject", "variant", "split", "region", "alignment", "metric", "value", "spread",
        "runs",
    ]  # fmt: skip


@pytest.mark.parametrize("text", [None, "{", "[]", '{"figures": []}'])
def test_a_file_that_cannot_be_read_is_named(text, tmp_path):
    if text is not None:
        (tmp_path / METRICS).write_text(text)
    with pytest.raises(InputError, match="metrics.json: .* what `gva-mi evaluate` writes"):
        Metrics.load(tmp_path)


@pytest.mark.parametrize("poses, refinement, seen",
    [("poses.npz", None, (["stage 1"], [], [])),
    ("poses_refined.npz", None, (["stage 1"], ["refine"], ["refine"])),
    ("poses_refined.npz", "seen", (["stage 1"], ["refine"], ["refine"])),
    ("poses_refined.npz", "held out", (["stage 1"], [], [])),
    ("poses_photometric.npz", None, (["stage 1", "track"], ["track"], []))])  # fmt: skip
def test_the_protocol_lists_who_has_seen_the_test_frames(poses, refinement, seen, video, tmp_path):
    if refinement is not None:
        (tmp_path / "refinement.json").write_text(
            json.dumps({"figures": [], "test_frames": refinement})
        )
    video = replace(video, normals=NormalMaps(tmp_path, "perspective", None))
    options = {"vgg16": None}
    found = protocol_of(Scorer(Weights()), video, tmp_path / poses, options)
    assert tuple(found["seen"].values()) == seen and found["masks"] == "the video's"
    assert found["training_loss"] == "rand_vgg" and found["networks"]["lpips"] is None
    ours = protocol_of(Scorer(Weights()), video, tmp_path / poses, {"vgg16": "my.pth"})
    assert ours["training_loss"] == "VGG16, my.pth"
