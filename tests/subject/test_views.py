"""Views that are held out: pictures by other cameras, under whichever poses the video has."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose
from gva_mi.core.errors import InputError
from gva_mi.splat import Camera, look_at
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.ground_truth import held_out_views
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

SIZE = (10, 12)


@pytest.fixture
def views(subject):
    """Frames 2 and 0 of the subject, by a camera each."""
    writer, cameras = SubjectWriter(subject), []
    for k, eye in enumerate(((3, 0, 0), (0, 1, -3))):
        image = np.full((*SIZE, 3), 40 * (k + 1), np.uint8)
        writer.views.frame(k, image)
        writer.views.mask(k, np.full(SIZE, 255, np.uint8))
        cameras.append(Camera(10, 10, 6, 5, look_at(eye, (0, 0, 0)), 12, 10))
    writer.views.cameras(cameras)
    writer.views_record([2, 0], ["b", "a"])
    return subject


def test_views_have_the_video_s_poses_and_their_own_cameras(views):
    video = load_video(views)
    transl = torch.tensor([[0.0, 0, 0], [7, 0, 0], [14, 0, 0]])
    moved = Pose(video.pose.rotations, transl, video.pose.expression)
    held = held_out_views(replace(video, pose=moved))
    assert len(held) == 2 and held.pose.transl[:, 0].tolist() == [14, 0]
    assert held[1].image[0, 0, 0] == np.float32(80 / 255) and held[1].mask.shape == SIZE
    assert np.allclose(held.cameras[0].position, (3, 0, 0)) and held.size == (12, 10)
    assert not held.absent and held.truth is None


def test_a_subject_without_them_has_none(subject):
    assert held_out_views(load_video(subject)) is None


FRAMES = "views/views.json"
DAMAGED = {
    "no frames": (lambda s: (s / FRAMES).write_text("{}"), "views.json: .*; expected .*frames"),
    "no such frame": (lambda s: (s / FRAMES).write_text('{"frames": [0, 3]}'), "frames 0 to 2"),
    "Boolean": (lambda s: (s / FRAMES).write_text('{"frames": [true]}'), "frames 0 to 2"),
    "more": (lambda s: (s / FRAMES).write_text('{"frames": [0, 1, 2]}'), "2 cameras for 3 pict"),
    "a small picture": (
        lambda s: write_image(s / "views/frames/000001.png", np.zeros((4, 5, 3), np.uint8)),
        "picture 1 is 5x4, expected 12x10"),
    "no mask": (lambda s: (s / "views/masks/000000.png").unlink(), "has no mask 0; expected one"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_views_are_refused_in_one_sentence(name, views):
    damage, words = DAMAGED[name]
    damage(views)
    with pytest.raises(InputError, match=words):
        held_out_views(load_video(views))
