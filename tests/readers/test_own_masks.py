"""Masks of a video that its user brings: which picture each belongs to, and whose it is."""

import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.readers.own_masks import WithMasks, write_own_masks
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.pictures import read_image, write_image

SIZE = (32, 48)  # width, height of the used pictures
COUNT = 7  # of the video's
USED = (1, 3, 5)


def masks(offset=0):
    """A bar that moves by two pixels from picture to picture, of twice the used size."""
    found = np.zeros((COUNT, 2 * SIZE[1], 2 * SIZE[0]), np.uint8)
    for k, mask in enumerate(found):
        mask[8:80, 4 * k + offset : 4 * k + offset + 20] = 255
    return found


NETWORK = [masks()[number, ::2, ::2] for number in USED]


@pytest.mark.parametrize("kind", ["array", "folder"])
def test_each_used_picture_gets_its_own(tmp_path, kind):
    source = tmp_path / "masks.npy"
    if kind == "array":
        np.save(source, masks() > 0)
    else:
        source = tmp_path / "masks"
        for k, mask in enumerate(masks()):
            write_image(source / f"shot{k + 100}.png", mask)
    notes = write_own_masks(SubjectWriter(tmp_path / "out"), source, USED, COUNT, SIZE, NETWORK)
    assert notes == [f"masks of {source}"]
    for k, number in enumerate(USED):
        found = read_image(tmp_path / f"out/masks/{k:06d}.png", 1)
        assert np.array_equal(found, masks()[number, ::2, ::2])


def test_masks_that_do_not_fit_are_described(tmp_path):
    def refused(given, sentence):
        np.save(tmp_path / "m.npy", given)
        with pytest.raises(InputError, match=sentence):
            write_own_masks(
                SubjectWriter(tmp_path / "out"), tmp_path / "m.npy", USED, COUNT, SIZE, NETWORK
            )

    refused(masks()[:4], "holds 4 masks, but the video has 7 pictures; expected a mask for each")
    twice = masks().repeat(2, axis=0)
    refused(twice, "holds 14 masks, but the video has 7 pictures; expected a mask for each")
    refused(masks()[:, :, :40], "mask 1: 40x96, but the video's pictures are 32x48")
    refused(masks(offset=24), "its masks do not lie on the person of the video")
    refused(np.zeros_like(masks()), "no pixel of any mask is above half")


def test_two_networks_are_two_witnesses(tmp_path):
    doubtful = np.array([[0, 0, 255, 255, 77, 77]], np.uint8)
    write_image(tmp_path / "000000.png", np.array([[0, 255, 0, 255, 0, 255]], np.uint8))
    found = WithMasks([doubtful, doubtful], tmp_path)
    assert len(found) == 2
    ((neither, second, first, both, against, with_it),) = found[0]
    assert neither == 1 and both == 254 and {first, second} <= {127, 128}
    assert against < 77 / 2 and with_it > 255 - 77 / 2
    assert np.array_equal(found[1], doubtful)  # of which there is no mask
