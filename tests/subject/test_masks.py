"""Masks of every form are read by one rule, a folder's own and those that ``prepare`` is given."""

import numpy as np
import pytest
from PIL import Image

from gva_mi import InputError
from gva_mi.subject.footage import masks
from gva_mi.subject.masks import read_mask
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video_file import write_video

INSIDE = np.zeros((20, 30), bool)
INSIDE[5:16, 8:20] = True
HARD = INSIDE * np.uint8(255)
SOFT = np.round(np.linspace(0, 255, 600)).reshape(20, 30).astype(np.uint8)
PHOTO = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)


def grey(values, *more):
    """Channels of these values, and others beside them."""
    return np.stack([values] * 3 + list(more), axis=-1)


def palette(labels, *colors, transparency=None):
    image = Image.fromarray(np.asarray(labels, np.uint8), mode="P")
    image.putpalette([x for color in colors for x in color])
    if transparency is not None:
        image.info["transparency"] = transparency
    return image


BLACK, WHITE, RED = (0, 0, 0), (255, 255, 255), (128, 0, 0)
FULL = np.full_like(HARD, 255)
FORMS = {  # an array, or a picture, and the mask
    "0 and 1": (INSIDE.astype(np.uint8), HARD),
    "a label": (INSIDE.astype(np.uint8) * 3, HARD),
    "Boolean": (INSIDE, HARD),
    "whole numbers to 1": (INSIDE.astype(np.int64), HARD),
    "whole numbers to 255": (HARD.astype(np.int32), HARD),
    "shares": (SOFT / np.float64(255), SOFT),
    "16 bits": (SOFT.astype(np.uint16) * 257, SOFT),
    "soft": (Image.fromarray(SOFT), SOFT),
    "opaque RGBA": (Image.fromarray(grey(HARD, FULL)), HARD),
    "a photograph cut out, softly": (Image.fromarray(np.dstack([PHOTO, SOFT])), SOFT),
    "one bit": (Image.fromarray(INSIDE), HARD),
    "a picture of 16 bits": (Image.fromarray(HARD.astype(np.uint16) * 257), HARD),
    "RGB": (Image.fromarray(grey(SOFT)), SOFT),
    "black and white amid colours": (palette(INSIDE * 3, BLACK, RED, RED, WHITE), HARD),
    "labels, 0 in colour": (palette(INSIDE, RED, (0, 0, 128)), HARD),
    "a palette cut out": (palette(INSIDE, RED, RED, transparency=bytes([0, 255])), HARD),
}


@pytest.mark.parametrize("name", FORMS)
def test_subjects_and_prepare_read_a_mask_alike(name, tmp_path):
    given, expected = FORMS[name]
    if isinstance(given, np.ndarray):
        np.save(tmp_path / "000000.npy", given)
    else:
        given.save(tmp_path / "000000.png")
    (prepared,) = masks(tmp_path)
    own = read_mask(tmp_path, 0)
    assert own.dtype == np.float32
    assert np.array_equal(prepared, expected) and np.allclose(own, expected / 255, atol=1e-6)


@pytest.mark.parametrize("full", [65535, 255, 1])
def test_values_of_16_bits_mean_the_same_in_every_frame(full, tmp_path):
    """A frame that barely shows the person is in the unit of the others, dim as it is."""
    for k, most in enumerate((full, full // 255, 0)):
        Image.fromarray((INSIDE * most).astype(np.uint16)).save(tmp_path / f"{k:06d}.png")
    shares = [read_mask(tmp_path, k).max() for k in range(3)]
    assert np.allclose(shares, [1, (full // 255) / full, 0], atol=0.5 / 255)


def test_an_empty_mask_is_one_and_a_missing_one_is_none(tmp_path):
    write_image(tmp_path / "000000.png", np.zeros((5, 7)))
    assert not read_mask(tmp_path, 0).any()
    assert read_mask(tmp_path, 1) is None


def test_videos_and_stacks_of_masks_are_read_by_the_same_rule(tmp_path):
    hard, recording = np.kron(HARD, np.ones((2, 2), np.uint8)), tmp_path / "masks.mp4"
    write_video(recording, [grey(hard)] * 3)
    found = list(masks(recording))
    assert len(found) == 3 and all(np.array_equal(mask, hard) for mask in found)
    write_video(recording, [PHOTO])
    with pytest.raises(InputError, match=r"masks\.mp4: picture 0: a mask in colours"):
        list(masks(recording))
    np.save(tmp_path / "masks.npy", np.stack([SOFT / 255, 0 * SOFT]))
    first, second = masks(tmp_path / "masks.npy")
    assert np.array_equal(first, SOFT) and not second.any()


REFUSED = {
    "three axes": (np.ones((5, 7, 3), bool), r"must be \(H, W\), got \(5, 7, 3\)"),
    "NaN": (np.full((5, 7), np.nan), r"must lie in \[0, 1\]"),
    "floats to 255": (np.full((5, 7), 255.0), r"must lie in \[0, 1\]"),
    "complex": (np.ones((5, 7), complex), "Boolean or numbers, got complex128"),
    "labels": (np.arange(35).reshape(5, 7) % 3, "the masks hold the labels 0-2"),
    "a photograph": (Image.fromarray(PHOTO), r"000000\.png: a mask in colours"),
    "red": (Image.fromarray(np.dstack([HARD, 0 * HARD, 0 * HARD])), "a mask in colours"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_anything_else_is_refused(name, tmp_path):
    given, sentence = REFUSED[name]
    if isinstance(given, np.ndarray):
        np.save(tmp_path / "000000.npy", given)
    else:
        given.save(tmp_path / "000000.png")
    with pytest.raises(InputError, match=sentence):
        read_mask(tmp_path, 0)


@pytest.mark.parametrize("value", [-4.0, np.nan, 300.0])
def test_values_beyond_the_range_are_refused(value, tmp_path):
    np.save(tmp_path / "masks.npy", np.where(INSIDE, 8.0, value)[None])
    with pytest.raises(InputError, match=r"masks\.npy: mask 0: its values go from"):
        list(masks(tmp_path / "masks.npy"))
