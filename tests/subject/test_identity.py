"""A video's identity covers what a fit sees of it, and nothing else."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gva_mi.fit.run_folder import stamps
from gva_mi.subject.pictures import write_image
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import load_video


@pytest.fixture
def video(subject):
    """Of the tiny subject, but no two masks are the same."""
    for k in range(3):
        mask = np.where(np.arange(8) < 5 + k, 255, 0).astype(np.uint8)
        write_image(subject / f"masks/{k:06d}.png", np.tile(mask, (6, 1)))
    return load_video(subject)


def differing(known, video):
    """Return the parts whose stamps differ."""
    return [part for part, stamp in stamps(video).items() if stamp != known[part]]


def test_a_copied_video_has_the_same_identity(video, subject, tmp_path):
    copied = shutil.copytree(subject, tmp_path / "copy")
    (copied / "notes.txt").write_text("not looked at")
    assert differing(stamps(video), load_video(copied)) == []


@pytest.mark.parametrize("part", ["frames", "masks"])
def test_a_changed_file_is_another_video(part, video, subject, tmp_path):
    folder = shutil.copytree(subject, tmp_path / "other")
    first, second = folder / part / "000000.png", folder / part / "000001.png"
    assert first.read_bytes() != second.read_bytes()
    shutil.copy(second, first)
    assert differing(stamps(video), load_video(folder)) == [part]


def test_changed_numbers_are_another_video(video):
    others = {
        "cameras": replace(video, cameras=[c.zoomed(1.01) for c in video.cameras]),
        "poses": replace(video, pose=video.pose.map(lambda x: x + 1e-6)),
        "splits": replace(video, splits=Splits(video.splits.test, video.splits.train)),
    }
    for part, other in others.items():
        assert differing(stamps(video), other) == [part]
