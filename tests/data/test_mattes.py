"""Pictures as masks: a folder's own and those that ``prepare`` is given are read by one rule."""

import numpy as np
import pytest
from PIL import Image

from gva_mi import InputError
from gva_mi.data.importers.footage import masks
from gva_mi.data.masks import read_mask
from gva_mi.data.pictures import write_film

INSIDE = np.zeros((20, 30), bool)
INSIDE[5:16, 8:20] = True
HARD = INSIDE * np.uint8(255)
SOFT = np.round(np.linspace(0, 255, 600)).reshape(20, 30).astype(np.uint8)
PHOTO = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)


def grey(values, *more):
    """Channels of these values, and others beside them."""
    return np.stack([values] * 3 + list(more), axis=-1)


def palette(labels, *colors):
    image = Image.fromarray(np.asarray(labels, np.uint8), mode="P")
    image.putpalette([x for color in colors for x in color])
    return image


def see_through(image, transparency):
    image.info["transparency"] = transparency
    return image


BLACK, WHITE, RED = (0, 0, 0), (255, 255, 255), (128, 0, 0)
FULL = np.full_like(HARD, 255)
SAME = {
    "opaque RGBA": (Image.fromarray(grey(HARD, FULL)), HARD),
    "a photograph cut out, softly": (Image.fromarray(np.dstack([PHOTO, SOFT])), SOFT),
    "one bit": (Image.fromarray(INSIDE), HARD),
    "16 bits": (Image.fromarray(HARD.astype(np.uint16) * 257), HARD),
    "RGB": (Image.fromarray(grey(SOFT)), SOFT),
    "black first": (palette(INSIDE, BLACK, WHITE), HARD),
    "black and white amid colours": (palette(INSIDE * 3, BLACK, RED, RED, WHITE), HARD),
    "labels in colours": (palette(INSIDE * 2, BLACK, RED, (0, 9, 0)), HARD),
    "labels, 0 in colour": (palette(INSIDE, RED, (0, 0, 128)), HARD),
    "a palette cut out": (see_through(palette(INSIDE, RED, RED), bytes([0, 255])), HARD),
    "red": (Image.fromarray(np.dstack([HARD, 0 * HARD, 0 * HARD])), HARD),
    "softly red": (Image.fromarray(np.dstack([SOFT, 0 * SOFT, 0 * SOFT])), None),
}


def both(folder):
    """What the two readers make of a folder's one mask, 8-bit."""
    (prepared,) = masks(folder)
    return prepared, np.round(read_mask(folder, 0) * 255).astype(np.uint8)


@pytest.mark.parametrize("name", SAME)
def test_subjects_and_prepare_read_a_mask_alike(name, tmp_path):
    image, expected = SAME[name]
    image.save(tmp_path / "000000.png")
    prepared, own = both(tmp_path)
    assert np.array_equal(prepared, own)
    if expected is not None:
        assert np.array_equal(own, expected)
    else:  # as much as there is of its mean colour, which is brighter than a half
        assert np.array_equal(own > 0, SOFT > 0) and (np.diff(own.ravel().astype(int)) >= 0).all()


def test_a_red_mask_survives_jpeg(tmp_path):
    large = np.kron(HARD, np.ones((8, 8), np.uint8))
    image = Image.fromarray(np.dstack([large, 0 * large, 0 * large]))
    image.save(tmp_path / "0.jpg", quality=80)
    (found,) = masks(tmp_path)
    assert ((found > 127) != (large > 127)).mean() < 0.01


COLORED = np.zeros((20, 30, 3), np.uint8)
COLORED[5:16, 8:14], COLORED[5:16, 14:20] = (255, 0, 0), (0, 255, 0)
DOUBTFUL = {
    "a photograph": PHOTO,
    "labels drawn": COLORED,
    "a colour before another": np.where(INSIDE[..., None], (255, 0, 0), (0, 0, 255)).astype("u1"),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_mask_in_several_colours_is_refused(name, tmp_path):
    Image.fromarray(DOUBTFUL[name]).save(tmp_path / "000000.png")
    for read in (lambda: list(masks(tmp_path)), lambda: read_mask(tmp_path, 0)):
        with pytest.raises(InputError, match=r"000000\.png: a mask in several colours") as error:
            read()
        assert "\n" not in str(error.value)


def test_a_film_of_masks_is_read_by_the_same_rule(tmp_path):
    hard = np.kron(HARD, np.ones((2, 2), np.uint8))
    film = tmp_path / "masks.mp4"
    for picture in (grey(hard), np.dstack([hard, 0 * hard, 0 * hard])):
        write_film(film, [picture] * 3)
        found = list(masks(film))
        assert len(found) == 3 and all(np.array_equal(mask, hard) for mask in found)
    write_film(film, [PHOTO])
    with pytest.raises(InputError, match=r"masks\.mp4: picture 0: a mask in several colours"):
        list(masks(film))


ARRAYS = {
    "Boolean": (INSIDE, HARD),
    "whole numbers to 1": (INSIDE.astype(np.int64), HARD),
    "to 255": (HARD.astype(np.int32), HARD),
    "shares": (SOFT / np.float64(255), SOFT),
    "16 bits": (SOFT.astype(np.uint16) * 257, SOFT),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_every_range_are_scaled_to_255(name, tmp_path):
    given, expected = ARRAYS[name]
    np.save(tmp_path / "masks.npy", np.stack([given, 0 * given]))
    first, second = masks(tmp_path / "masks.npy")
    assert np.array_equal(first, expected) and not second.any()
    np.save(tmp_path / "0.npy", given)
    (tmp_path / "masks.npy").unlink()
    (found,) = masks(tmp_path)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("value", [-4.0, np.nan, 300.0])
def test_values_beyond_the_range_are_refused(value, tmp_path):
    given = np.where(INSIDE, 8.0, value)
    np.save(tmp_path / "masks.npy", given[None])
    with pytest.raises(InputError, match=r"masks\.npy: mask 0: its values go from"):
        list(masks(tmp_path / "masks.npy"))
