"""One look at a video, before hours of work."""

import numpy as np
import pytest
from PIL import Image

from gva_mi.data.check.glance import glance
from gva_mi.data.video import load_video


def cut(subject, top, bottom):
    """Leave what lies between two shares of the height of every picture."""
    with np.load(subject / "cameras.npz") as stored:
        cameras = dict(stored)
    height = int(cameras["height"])
    first, last = round(top * height), round(bottom * height)
    for path in (*subject.glob("frames/*.png"), *subject.glob("masks/*.png")):
        picture = Image.open(path)
        picture.crop((0, first, picture.width, last)).save(path)
    cameras["height"] = np.array(last - first)
    cameras["K"][..., 1, 2] -= first
    np.savez(subject / "cameras.npz", **cameras)
    return load_video(subject, normals="none")


@pytest.mark.parametrize("bottom", [1.0, 0.55, 0.4])
def test_who_is_cut_off_by_the_picture_raises_no_doubt(subject, built_in_body, bottom):
    assert glance(cut(subject, 0.0, bottom), built_in_body) is None


def test_who_is_hardly_in_the_picture_does(subject, built_in_body):
    doubt = glance(cut(subject, 0.68, 1.0), built_in_body)
    assert "of the body's joints lie in the picture, expected most of them" in doubt


def test_inverted_masks_do(subject, built_in_body):
    for path in subject.glob("masks/*.png"):
        Image.fromarray(255 - np.asarray(Image.open(path))).save(path)
    doubt = glance(load_video(subject, normals="none"), built_in_body)
    assert "of the body's joints lie in the masks" in doubt and str(subject) in doubt
