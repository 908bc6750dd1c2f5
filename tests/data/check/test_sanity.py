"""The sanity check before hours of work warns of a body that is not where the masks are."""

import numpy as np
import pytest
from PIL import Image

from gva_mi.data.check.sanity import sanity_check
from gva_mi.data.video import load_video


def cut(subject, top, bottom):
    """Crop every picture to what lies between two shares of its height."""
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
def test_a_person_cut_off_by_the_picture_is_no_doubt(subject, built_in_body, bottom):
    assert sanity_check(cut(subject, 0.0, bottom), built_in_body) is None


def test_a_person_hardly_in_the_picture_is_doubtful(subject, built_in_body):
    doubt = sanity_check(cut(subject, 0.68, 1.0), built_in_body)
    assert "of the body's joints lie in the picture, expected most of them" in doubt


def test_a_person_far_away_in_the_middle_of_the_masks_is_doubtful(subject, built_in_body):
    """All joints of a person a kilometre away lie in the masks, in one pixel of them."""
    with np.load(subject / "cameras.npz") as stored:
        cameras = dict(stored)
    for path in subject.glob("masks/*.png"):
        mask = np.zeros((int(cameras["height"]), int(cameras["width"])), np.uint8)
        mask[10:-10, 10:-10] = 255
        Image.fromarray(mask).save(path)
    cameras["K"][..., :2, 2] = mask.shape[1] / 2, mask.shape[0] / 2
    cameras["T_camera_world"][..., 2, 3] += 1000
    np.savez(subject / "cameras.npz", **cameras)
    doubt = sanity_check(load_video(subject, normals="none"), built_in_body)
    assert "0% of the body and of the masks is in both" in doubt and str(subject) in doubt


def test_inverted_masks_are_doubtful(subject, built_in_body):
    for path in subject.glob("masks/*.png"):
        Image.fromarray(255 - np.asarray(Image.open(path))).save(path)
    doubt = sanity_check(load_video(subject, normals="none"), built_in_body)
    assert "of the body's joints lie in the masks" in doubt and str(subject) in doubt
