"""Values that do not fit into memory come back from disk bit-identical."""

import errno
import pickle

import pytest
import torch

from gva_mi.core.spill_cache import SpillCache


def values(count):
    generator = torch.Generator().manual_seed(0)
    return {k: (torch.rand(40, generator=generator), None, f"frame {k}") for k in range(count)}


def same(a, b):
    return torch.equal(a[0], b[0]) and a[1:] == b[1:]


@pytest.mark.parametrize("kept", [0, 2000, 1 << 20])  # all on disk, some, none
def test_values_come_back_and_parts_are_renumbered(kept, tmp_path):
    cache, wanted = SpillCache(tmp_path, kept), values(12)
    for k in (3, 0, *range(4, 12), 1, 2):
        cache[k] = wanted[k]
    assert len(cache) == 12 and list(cache) == list(range(12)) and 12 not in cache and 3 in cache
    assert all(same(cache[k], wanted[k]) for k in wanted)
    cache[5] = wanted[0]
    assert same(cache[5], wanted[0]) and len(cache) == 12
    with pytest.raises(KeyError):
        cache[12]
    part = cache.part([7, 3, 99], 3)
    assert list(part) == [0, 4] and same(part[4], wanted[7]) and 1 not in part
    for sent, there in ((part, {0: 3, 4: 7}), (cache, {k: k for k in cache} | {5: 0})):
        got = pickle.loads(pickle.dumps(sent))
        assert type(got) is dict and got.keys() == there.keys()
        assert all(same(got[k], wanted[n]) for k, n in there.items())
    assert not list(tmp_path.iterdir())  # the file has no name, so nobody has to remove it


def test_a_full_disk_is_an_error_with_the_folder_s_name(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gva_mi.core.spill_cache.tempfile.TemporaryFile", full)
    with pytest.raises(OSError) as error:
        SpillCache(tmp_path, 0)[0] = 1
    assert error.value.errno == errno.ENOSPC and error.value.filename == str(tmp_path)
