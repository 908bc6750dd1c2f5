"""What is written comes back; what cannot be used is refused in one sentence that says where."""

import json
import shutil

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.body.pose import save_poses
from gva_mi.subject.pictures import read_image, write_image
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import write_video


def test_a_subject_comes_back_as_it_was_written(subject):
    video = load_video(subject)
    assert len(video) == 3 and video.size == (8, 6) and video.normals is None
    frame = video[1]
    expected = read_image(subject / "frames/000001.png", 3) / np.float32(255)
    assert np.array_equal(frame.image, expected)
    assert frame.normals is None and frame.mask.sum() == 16
    assert len(frame.pose) == 1
    picture = frame.on_background(1.0)
    assert (picture[frame.mask == 0] == 1).all()
    assert np.array_equal(picture[frame.mask == 1], frame.image[frame.mask == 1])


def test_a_lossless_video_reads_like_frames(subject):
    frames = [f.image for f in load_video(subject).frames()]
    write_video(subject / "video.mp4", frames)
    shutil.rmtree(subject / "frames")
    for frame, image in zip(load_video(subject).frames(), frames, strict=True):
        assert np.array_equal(frame.image, image)


def test_absent_frames_belong_to_no_split(subject):
    (subject / "frames/000001.png").unlink()
    (subject / "splits.json").write_text(json.dumps({"train": [0, 1], "test": [2]}))
    video = load_video(subject)
    assert len(video) == 3 and video.absent == {1: "it has no picture"}
    assert video.splits == Splits(train=[0], test=[2])
    assert not video[1].mask.any() and video[1].normals is None and len(video[1].pose) == 1

    (subject / "masks/000000.png").unlink()
    assert load_video(subject).absent[0] == "it has no mask"
    write_image(subject / "masks/000000.png", np.zeros((6, 8)))
    assert load_video(subject).absent[0] == "its mask is empty"
    write_image(subject / "masks/000002.png", np.zeros((6, 8)))
    with pytest.raises(InputError, match="no frame can be used; frame 0: its mask is empty"):
        load_video(subject)


def test_splits_share_no_frame_and_lose_none():
    every, middle, recording = Splits.every(37), Splits.one_range(64), Splits.of_video(60)
    assert middle.test == list(range(28, 36)) and Splits.one_range(3).test == [1]
    assert recording.held_out_range == list(range(42, 48)) and set(recording.test) > set(
        range(42, 48)
    )
    assert recording.without({44}).held_out_range == [42, 43, 45, 46, 47]
    for splits, count in (
        (every, 37),
        (middle, 64),
        (recording, 60),
        (Splits.of_video(3), 3),
        (Splits.of_video(1), 1),
    ):
        assert sorted(splits.train + splits.test) == list(range(count))


BAD = {  # what the broken folders of tests/samples/broken_cases.py do not have
    "no last frame": (lambda s: (s / "frames/000002.png").unlink(), "but the video has 2"),
    "a name": (
        lambda s: (s / "frames/000001.png").rename(s / "frames/b.png"),
        "frames are numbered, such as 000000.png",
    ),
    "mask size": (
        lambda s: write_image(s / "masks/000001.png", np.ones((6, 9))),
        "mask of frame 1 is 9x6, expected 8x6",
    ),
    "frame size": (
        lambda s: write_image(s / "frames/000002.png", np.zeros((6, 9, 3))),
        "frame 2 is 9x6, but cameras.npz says 8x6",
    ),
    "split twice": (
        lambda s: (s / "splits.json").write_text(json.dumps({"train": [0, 1], "test": [1]})),
        "frame 1 is in both",
    ),
    "range in training": (
        lambda s: (s / "splits.json").write_text(
            json.dumps({"train": [0, 1], "test": [2], "held_out_range": [1, 2]})
        ),
        "frame 1 of the held-out range is no test frame",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_that_says_where(subject, name):
    spoil, sentence = BAD[name]
    spoil(subject)
    with pytest.raises(InputError, match=sentence):
        load_video(subject)


def test_a_file_of_poses_holds_its_stage(subject):
    video = load_video(subject)
    save_poses(subject / "refined.npz", video.pose, video.shape, stage=2)
    assert video.stage == 1 and load_video(subject, subject / "refined.npz").stage == 2
    arrays = dict(np.load(subject / "refined.npz"))
    del arrays["stage"]
    np.savez(subject / "silent.npz", **arrays)
    assert load_video(subject, subject / "silent.npz").stage == 1
    np.savez(subject / "odd.npz", **arrays, stage=np.array(7))
    with pytest.raises(InputError, match="'stage' must be 0"):
        load_video(subject, subject / "odd.npz")


def test_outlines_are_the_frames_without_their_pictures(subject):
    """Normals of some frames are unit inside the mask and zero outside."""
    (subject / "normals").mkdir()
    normals = np.random.default_rng(0).standard_normal((6, 8, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.save(subject / "normals/000001.npy", normals)
    video, part = load_video(subject), np.s_[1:5, 2:7]
    for frame, outline in zip(video.frames([0, 1]), video.outlines([0, 1]), strict=True):
        np.testing.assert_array_equal(outline.mask, frame.mask)
        seen = outline.normals(part)
        assert (seen is None) == (frame.normals is None) == (frame.index == 0)
        if seen is not None:
            np.testing.assert_array_equal(seen, frame.normals[part])
            length = np.linalg.norm(frame.normals, axis=-1)
            np.testing.assert_allclose(length, frame.mask, atol=1e-5)
    assert load_video(subject, normals="none").normals is None
