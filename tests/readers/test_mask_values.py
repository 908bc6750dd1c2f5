"""Units and labels of masks are decided once for a video, in every container."""

import numpy as np
import pytest
from PIL import Image

from gva_mi import InputError
from gva_mi.subject.footage import masks
from gva_mi.subject.masks import read_mask

SHAPE, FRAMES = (48, 64), 5
ME, OTHER = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
ME[2:44, 18:42], OTHER[5:45, 44:60] = True, True
NOISE = np.zeros(SHAPE, np.uint8)
NOISE[3, 7] = 1


def stored(folder, drawn, container):
    """Save arrays (H, W) as a folder of pictures, of arrays, of palettes, or as one array."""
    folder.mkdir()
    for k, x in enumerate(drawn):
        if container == "pictures":
            Image.fromarray(x.astype(np.uint8)).save(folder / f"{k:06d}.png")
        elif container == "palettes":
            image = Image.fromarray(x.astype(np.uint8), mode="P")
            image.putpalette(
                [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0, 0, 0, 128] + [9, 9, 8] * 251
            )
            image.save(folder / f"{k:06d}.png")
        elif container == "arrays":
            np.save(folder / f"{k:06d}.npy", x)
    if container == "array":
        np.save(folder.with_suffix(".npy"), np.stack(drawn))
        return folder.with_suffix(".npy")
    return folder


@pytest.mark.parametrize("container", ["pictures", "arrays", "array"])
def test_a_frame_of_noise_alone_is_read_in_the_units_of_the_others(container, tmp_path):
    """Its largest value is 1, of 255: it is empty, and not a full mask of zeros and ones."""
    drawn = [NOISE, ME * np.uint8(255), NOISE]
    found = list(masks(stored(tmp_path / "m", drawn, container)))
    assert [int(x.max()) for x in found] == [1, 255, 1] and np.array_equal(found[1] > 127, ME)
    ones = [ME * np.uint8(1), 0 * NOISE, NOISE]
    found = list(masks(stored(tmp_path / "n", ones, container)))
    assert [int(x.max()) for x in found] == [255, 0, 255] and np.array_equal(found[0] > 127, ME)


@pytest.mark.parametrize("container", ["pictures", "arrays"])
def test_a_subjects_own_masks_are_in_one_unit_too(container, tmp_path):
    folder = stored(tmp_path / "m", [NOISE, ME * np.uint8(255), NOISE], container)
    assert read_mask(folder, 0).max() < 0.01 and np.array_equal(read_mask(folder, 1) > 0.5, ME)
    folder = stored(tmp_path / "n", [NOISE, ME * np.uint8(1)], container)
    assert read_mask(folder, 0).max() == 1 and np.array_equal(read_mask(folder, 1) > 0.5, ME)


RING = np.indices(SHAPE).sum(0) % 7 == 0  # pixels here and there


@pytest.mark.parametrize("drawn", [
    [200 * ME, 0 * ME], [128 * ME, 128 * ME], [np.uint16(43690) * ME, 256 * OTHER * 0],
    [np.where(ME & RING, 255, ME)] * 2,
], ids=["a label above half", "grey", "16 bits", "a label within a border"])  # fmt: skip
@pytest.mark.parametrize("container", ["arrays", "array"])
def test_few_numbers_below_the_unit_are_labels(drawn, container, tmp_path):
    """Else a person is half transparent, or the border is taken for the person."""
    given = stored(tmp_path / "m", [np.asarray(x, np.uint16) for x in drawn], container)
    ring = RING & (drawn[0].max() == 255)
    for k, mask in enumerate(masks(given)):
        assert np.array_equal(mask, 255 * ((drawn[k] > 0) & ~ring))


def test_masks_with_an_axis_of_channels_are_a_stack(tmp_path):
    for axis in (1, 3):
        np.save(tmp_path / "m.npy", np.expand_dims(np.stack([ME, ME]), axis))
        assert all(np.array_equal(mask > 127, ME) for mask in masks(tmp_path / "m.npy"))


@pytest.mark.parametrize("container", ["arrays", "palettes"])
def test_labels_of_several_people_are_refused(container, tmp_path):
    """Also where one of them is alone in the picture, and the largest value is 1."""
    given = stored(tmp_path / "m", [2 * ME + OTHER, 1 * OTHER], container)
    with pytest.raises(InputError, match="the masks hold the labels 0-2, and which one is the"):
        list(masks(given))
    if container == "palettes":
        with pytest.raises(InputError, match="the masks hold the labels 0-2, and which one is the"):
            read_mask(given, 0)


def test_a_border_round_each_object_is_nobodys(tmp_path):
    """PASCAL VOC draws it as label 255."""
    drawn = 3 * ME
    drawn[10, 20:40] = 255
    folder = stored(tmp_path / "m", [drawn, 0 * drawn], "palettes")
    (mask, _), inside = masks(folder), drawn == 3
    assert np.array_equal(mask > 127, inside) and np.array_equal(read_mask(folder, 0) > 0.5, inside)
