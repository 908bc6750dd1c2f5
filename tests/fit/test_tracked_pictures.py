"""Tracking fits poses to pictures that are no larger than they must be."""

import numpy as np
import pytest

from gva_mi.fit.photometric import shrunk_to_tall


@pytest.fixture
def tall(video, monkeypatch):
    """The person's height in the video, pixels, which is enough."""
    rows = [np.flatnonzero((frame.mask > 0.5).any(1)) for frame in video.frames()]
    height = np.median([row[-1] + 1 - row[0] for row in rows])
    monkeypatch.setattr("gva_mi.fit.photometric.PERSON_PIXELS", height)
    return height


def test_a_shrunk_video_has_the_means_of_blocks_and_sees_the_same(video, doubled):
    for frame, small in zip(video.frames(), doubled.downscaled(2).frames(), strict=True):
        assert np.array_equal(small.image, frame.image) and np.array_equal(small.mask, frame.mask)
        assert small.camera == frame.camera
    odd, point = video.downscaled(5), np.array([[0.1, 0.2, 0.3]])
    assert odd.size == (48 // 5, 48 // 5)
    assert np.allclose(odd[0].image[3, 4], video[0].image[15:20, 20:25].mean((0, 1)))
    assert np.allclose(5 * odd.cameras[0].project(point), video.cameras[0].project(point))


def test_the_smallest_pictures_are_taken_that_are_enough(video, doubled, tall, monkeypatch):
    for enough, shrink in ((2.1 * tall, 1), (tall, 2), (tall / 1.9, 3)):
        monkeypatch.setattr("gva_mi.fit.photometric.PERSON_PIXELS", enough)
        assert shrunk_to_tall(doubled).shrink == shrink
    monkeypatch.undo()
    assert shrunk_to_tall(doubled) is doubled
