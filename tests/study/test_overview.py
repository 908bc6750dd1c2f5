"""The first picture of a run: cut by true masks, and new poses beside their ground truth."""

import shutil

import numpy as np

from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video
from gva_mi.study.overview import HEIGHT, overview
from gva_mi.study.pictures import ShownAvatar


def test_frames_are_cut_by_the_true_mask_where_it_is_known(subject, tmp_path):
    folder = shutil.copytree(subject, tmp_path / "subject")
    true = np.zeros_like(load_video(folder)[3].mask)
    true[::2] = 1
    write_image(folder / "truth/masks/000003.png", true)
    video = load_video(folder)
    assert np.array_equal(video.truly_cut(video[3]).mask, true)
    assert np.array_equal(video.truly_cut(video[2]).mask, video[2].mask)


def test_new_poses_are_shown_beside_their_ground_truth(known, studio, body):
    image = overview(ShownAvatar.of(known, studio, body), studio)
    assert image.shape[0] == 2 * HEIGHT
    row = image[HEIGHT:].astype(float)  # it ends with a hand and its render
    target, rendered = row[:, -2 * HEIGHT : -HEIGHT], row[:, -HEIGHT:]
    off = np.abs(target - rendered).mean()  # the same avatar; one of them enlarged
    assert off < 0.6 * np.abs(target - target.mean((0, 1))).mean()
