"""Masks of every form read the same."""

import numpy as np
import pytest
from PIL import Image

from gva_mi import InputError
from gva_mi.data.masks import read_mask
from gva_mi.data.pictures import write_image

INSIDE = np.zeros((5, 7), bool)
INSIDE[1:4, 2:5] = True

HARD = {
    "0 and 255": INSIDE.astype(np.uint8) * 255,
    "0 and 1": INSIDE.astype(np.uint8),
    "Boolean": INSIDE,
    "float": INSIDE.astype(np.float64), "whole": INSIDE.astype(np.int64),
    "16 bits": INSIDE.astype(np.uint16) * 65535, "a label": INSIDE.astype(np.uint8) * 3,
}  # fmt: skip


PIXELS = [name for name, mask in HARD.items() if mask.dtype in (np.uint8, np.uint16)]


@pytest.mark.parametrize(
    ("suffix", "name"), [("npy", name) for name in HARD] + [("png", name) for name in PIXELS]
)
def test_hard_masks_of_every_form_read_the_same(name, suffix, tmp_path):
    if suffix == "npy":
        np.save(tmp_path / "000003.npy", HARD[name])
    else:
        Image.fromarray(HARD[name]).save(tmp_path / "000003.png")
    mask = read_mask(tmp_path, 3)
    assert mask.dtype == np.float32
    np.testing.assert_array_equal(mask, INSIDE)


def test_soft_masks_keep_their_values(tmp_path):
    soft = np.linspace(0, 1, 35).reshape(5, 7)
    write_image(tmp_path / "000000.png", soft)
    np.save(tmp_path / "000001.npy", soft)
    np.testing.assert_allclose(read_mask(tmp_path, 0), soft, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(read_mask(tmp_path, 1), soft, atol=1e-7)


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


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (np.ones((5, 7, 3), bool), r"must be \(H, W\), got \(5, 7, 3\)"),
        (np.full((5, 7), np.nan), r"must lie in \[0, 1\]"),
        (np.full((5, 7), 255.0), r"must lie in \[0, 1\]"),
        (np.ones((5, 7), complex), "Boolean or numbers, got complex128"),
        (np.arange(35).reshape(5, 7) % 3, "masks of labels 0-2"),
    ],
)
def test_anything_else_is_refused(value, sentence, tmp_path):
    np.save(tmp_path / "000000.npy", value)
    with pytest.raises(InputError, match=sentence):
        read_mask(tmp_path, 0)
