"""Values that do not fit into memory are the same from disk, to the bit."""

import errno
import pickle

import pytest
import torch

from gva_mi.shelf import Shelf


def values(count):
    generator = torch.Generator().manual_seed(0)
    return {k: (torch.rand(40, generator=generator), None, f"frame {k}") for k in range(count)}


def same(a, b):
    return torch.equal(a[0], b[0]) and a[1:] == b[1:]


@pytest.mark.parametrize("kept", [0, 2000, 1 << 20])  # all on disk, some, none
def test_what_was_put_in_comes_out(kept, tmp_path):
    shelf, wanted = Shelf(tmp_path, kept), values(12)
    for k in (3, 0, *range(4, 12), 1, 2):
        shelf[k] = wanted[k]
    assert len(shelf) == 12 and list(shelf) == list(range(12)) and 12 not in shelf and 3 in shelf
    assert all(same(shelf[k], wanted[k]) for k in wanted)
    shelf[5] = wanted[0]
    assert same(shelf[5], wanted[0]) and len(shelf) == 12
    with pytest.raises(KeyError):
        shelf[12]
    assert not list(tmp_path.iterdir())  # its file has no name, so that nobody has to remove it


@pytest.mark.parametrize("kept", [0, 1 << 20])
def test_a_part_counts_from_its_first_and_travels_as_a_dictionary(kept, tmp_path):
    shelf, wanted = Shelf(tmp_path, kept), values(9)
    for k in (2, 3, 4, 7):
        shelf[k] = wanted[k]
    part = shelf.part(range(3, 8), 3)
    assert sorted(part) == [0, 1, 4] and len(part) == 3 and 4 in part and 2 not in part
    assert all(same(part[k], wanted[k + 3]) for k in part)
    for sent, there in ((part, {0: 3, 1: 4, 4: 7}), (shelf, {k: k for k in shelf})):
        got = pickle.loads(pickle.dumps(sent))
        assert type(got) is dict and all(same(got[k], wanted[n]) for k, n in there.items())
        assert got.keys() == there.keys()
    assert not shelf.part([0, 1])


def test_a_disk_that_is_full_is_an_error_with_the_folder_s_name(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gva_mi.shelf.tempfile.TemporaryFile", full)
    shelf = Shelf(tmp_path, 0)
    with pytest.raises(OSError) as error:
        shelf[0] = 1
    assert error.value.errno == errno.ENOSPC and error.value.filename == str(tmp_path)
