import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose
from gva_mi.data.crop import Box
from gva_mi.data.ground_truth import save_views
from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.renders import render_frame
from gva_mi.splat import look_at
from gva_mi.study.evaluate import evaluate, evaluate_views, views_of, with_trained_poses
from gva_mi.study.scores import PSNR_MAX, Scorer

NONE = Weights()  # whatever this machine has


def test_the_avatar_that_made_the_pictures_reaches_the_maximum(known, studio, body):
    rows = evaluate(known, studio, name="known", weights=NONE, body=body)
    whole = [row for row in rows if row.region == "white"]
    assert [(row.split, row.count) for row in whole] == [
        ("train", 1), ("test", 1), ("novel_pose", 2)
    ]  # fmt: skip
    assert {row.region for row in rows} == {"white", "black", "person", "hands"}
    for row in whole:
        assert (row.name, row.psnr, row.lpips) == ("known", PSNR_MAX, None)
        assert row.ssim == pytest.approx(1) and row.rand_vgg == 0


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
    rows = {row.region: row for row in evaluate_views(known, [marked], "x", Scorer(NONE))}
    assert rows["hands"].psnr == PSNR_MAX and rows["hands"].count == rows["face"].count == 1
    assert rows["face"].psnr < rows["white"].psnr < PSNR_MAX


@pytest.fixture
def watched(studio, known, camera, tmp_path):
    """The studio's subject with what a second camera saw of its two frames, and no truth."""
    folder = tmp_path / "watched"
    shutil.copytree(studio.folder, folder)
    shutil.rmtree(folder / "truth")
    T = look_at(camera.position + (0.3, 0.1, 0.0), (0.0, 0.0, 0.0))
    other = camera.with_matrices(T_camera_world=T)
    for k, frame in enumerate((1, 0)):
        picture = render_frame(known, studio.pose[frame], other)
        write_image(folder / f"views/frames/{k:06d}.png", picture)
        write_image(folder / f"views/masks/{k:06d}.png", np.ones(picture.shape[:2]))
    save_views(folder / "views", [1, 0], ["b", "b"], [other] * 2)
    return folder


def test_pictures_of_other_cameras_are_novel_views(known, watched, body):
    video = load_video(watched)
    rows = {row.split: row for row in evaluate(known, video, weights=NONE, body=body)
            if row.region == "white"}  # fmt: skip
    assert set(rows) == {"train", "test", "novel_view"} and rows["novel_view"].count == 2
    assert rows["novel_view"].psnr == PSNR_MAX


def test_views_of_other_cameras_use_the_trained_poses(known, watched):
    """Poses that are off by a centimetre before training: the trained ones count."""
    video = load_video(watched)
    off = replace(video, pose=Pose(video.pose.rotations, video.pose.transl + 0.01,
                                   video.pose.expression))  # fmt: skip
    given = {view.split: view for view in views_of(off)}
    trained = [with_trained_poses(view, video) for view in given.values()]
    before, after = (
        {row.split: row.psnr for row in evaluate_views(known, views, "x", Scorer(NONE))
         if row.region == "white"}
        for views in (list(given.values()), trained)
    )  # fmt: skip
    assert max(before.values()) < 45
    assert set(after.values()) == {PSNR_MAX}


def test_background_raises_the_psnr_of_the_whole_picture_but_not_of_the_box(known, subject):
    damaged = type(known).from_record(known.record())
    with torch.no_grad():
        damaged.canonical.means += 0.03
    rows = {
        row.region: row
        for row in evaluate(damaged, load_video(subject), splits=["test"], weights=NONE)
    }
    assert set(rows) == {"white", "black", "person"}  # without a body nobody looks for hands
    assert rows["person"].psnr < rows["white"].psnr
    assert rows["black"].psnr != rows["white"].psnr


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
    assert without[0].psnr < with_truth[0].psnr
