"""Files as Python, numpy, joblib, torch and scipy write them are read, and give plain arrays."""

import gzip
import pickle
import struct
import zlib
from collections import OrderedDict, defaultdict

import numpy as np
import pytest
from samples.joblib_files import joblib_dump

from gva_mi.core.errors import InputError
from gva_mi.core.pickles.reader import read_objects

ARRAY = np.arange(12, dtype=np.float32).reshape(3, 4)


def read(path):
    return read_objects(path, "anything")


def reread(tmp_path, data):
    path = tmp_path / "file.pkl"
    path.write_bytes(data)
    return read(path)


@pytest.mark.parametrize("protocol", (0, 2, 4, 5))
def test_every_protocol(tmp_path, protocol):
    value = {
        "c": ARRAY, "f": np.asfortranarray(ARRAY), "big": ARRAY.astype(">f8"), "none": None,
        "scalar": np.int64(7), "text": np.array(["male", "x"]), "bytes": np.array(b"male"),
        "bool": np.array([True, False]), "empty": np.zeros((0, 3)), "zero": np.array(2.5),
        "ordered": OrderedDict(a=1), "default": defaultdict(list, b=[2]), "set": {1, "a"},
        np.int64(3): (1, 2.5, "ü", b"\xff\x00", 10**30, 1j, True),
    }  # fmt: skip
    found = reread(tmp_path, pickle.dumps(value, protocol))
    assert list(found) == list(value)
    for key, wanted in value.items():
        if isinstance(wanted, np.ndarray):
            assert found[key].dtype == wanted.dtype and np.array_equal(found[key], wanted), key
            assert type(found[key]) is np.ndarray and found[key].flags.writeable
        else:
            assert found[key] == wanted, key
    assert type(found["ordered"]) is type(found["default"]) is dict


def test_what_python_2_wrote(tmp_path):
    """Protocol 0 and 2, with text as latin-1 strings, and numpy's names as they were."""
    code = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
    code += b"(I1\n(I2\ntcnumpy\ndtype\n(S'f4'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\n"
    code += b"S'\\x00\\x00\\x80?\\x00\\x00\\x00@'\ntb."
    assert reread(tmp_path, code).tolist() == [1, 2]


def test_objects_in_arrays(tmp_path):
    value = np.array([[{"a": ARRAY}, None]], dtype=object)
    found = reread(tmp_path, pickle.dumps(value))
    assert found.shape == (1, 2) and np.array_equal(found[0, 0]["a"], ARRAY)
    np.savez(tmp_path / "romp.npz", results={"cam": ARRAY}, frames=ARRAY)
    found = read(tmp_path / "romp.npz")
    assert np.array_equal(found["results"].item()["cam"], ARRAY)
    assert np.array_equal(found["frames"], ARRAY)
    np.save(tmp_path / "annots.npy", {"cams": {"K": [ARRAY]}}, allow_pickle=True)
    assert np.array_equal(read(tmp_path / "annots.npy").item()["cams"]["K"][0], ARRAY)


@pytest.mark.parametrize("pack", [bytes, zlib.compress, gzip.compress], ids=["plain", "zlib", "gz"])
def test_joblib(tmp_path, pack):
    value = {np.int64(0): {"pose": ARRAY, "again": ARRAY, "f": np.asfortranarray(ARRAY * 2)}}
    value["objects"] = np.array([{"a": 1}, None], dtype=object)
    found = reread(tmp_path, pack(joblib_dump(value)))
    person = found[0]
    assert np.array_equal(person["pose"], ARRAY) and np.array_equal(person["again"], ARRAY)
    assert np.array_equal(person["f"], ARRAY * 2) and found["objects"][0] == {"a": 1}


@pytest.mark.parametrize("way", ["pickle", "torch", "old torch"])
def test_tensors(tmp_path, way):
    import torch

    tensor = torch.arange(12.0).reshape(3, 4)
    value = {
        "t": tensor, "view": tensor[1:, ::2], "turned": tensor.T, "half": tensor.bfloat16(),
        "long": torch.arange(3), "p": torch.nn.Parameter(tensor), "wide": tensor[:1].expand(5, 4),
        "empty": torch.zeros(0, 3), "size": tensor.shape,
    }  # fmt: skip
    path = tmp_path / "file.pt"
    if way == "pickle":
        path.write_bytes(pickle.dumps(value))
    else:
        torch.save(value, path, _use_new_zipfile_serialization=way == "torch")
    found = read(path)
    assert found.pop("size") == (3, 4)
    for key, array in found.items():
        assert np.array_equal(array, value[key].detach().float().numpy()), key


@pytest.mark.parametrize("way", ["pickle", "old torch"])
def test_tensors_of_a_gpu(tmp_path, way):
    """Their file differs from that of a CPU's by the name of the device."""
    import torch

    value, path, length = torch.arange(10.0), tmp_path / "cuda.pkl", struct.Struct("<I")
    if way == "pickle":
        data = pickle.dumps(value, protocol=3)
    else:
        torch.save(value, path, _use_new_zipfile_serialization=False)
        data = path.read_bytes()
    data = data.replace(b"X\x03\0\0\0cpu", b"X\x06\0\0\0cuda:0")
    if way == "pickle":  # the storage is one long string, three letters longer now
        at = data.index(b"_load_from_bytes") + len("_load_from_bytes\n") + 2
        at = data.index(b"B", at)
        data = (
            data[: at + 1] + length.pack(length.unpack_from(data, at + 1)[0] + 3) + data[at + 5 :]
        )
    path.write_bytes(data)
    assert b"cuda:0" in data and read(path).tolist() == list(range(10))


def test_sparse_matrices(tmp_path):
    sparse = pytest.importorskip("scipy.sparse")
    for form in (sparse.csc_matrix, sparse.csr_matrix):
        for protocol in (0, 2, 5):
            found = reread(tmp_path, pickle.dumps(form(ARRAY * (ARRAY > 3)), protocol))
            assert np.array_equal(found, ARRAY * (ARRAY > 3)), (form, protocol)


def chumpy(name, state):
    """A chumpy object as protocol 2 writes it: its class, no arguments, its dictionary."""
    body = pickle.dumps(state, 2)[2:-1]
    module = {"Ch": "chumpy.ch", "Select": "chumpy.reordering"}[name]
    return b"c" + f"{module}\n{name}\n".encode() + b")\x81" + body + b"b"


def test_arrays_of_chumpy(tmp_path):
    whole = chumpy("Ch", {"x": ARRAY, "_dirty_vars": set(), "_itr": None})
    assert np.array_equal(reread(tmp_path, b"\x80\x02" + whole + b"."), ARRAY)
    # Its selection of elements names another chumpy array in its state.
    state = b"}(U\x01a" + whole + b"U\x04idxs" + pickle.dumps(np.array([4, 0]), 2)[2:-1] + b"u"
    select = b"cchumpy.reordering\nSelect\n)\x81" + state + b"b"
    assert reread(tmp_path, b"\x80\x02" + select + b".").tolist() == [4, 0]


def test_a_list_that_holds_itself(tmp_path):
    value = [1]
    value.append(value)
    found = reread(tmp_path, pickle.dumps(value))
    assert found[1] is found


def test_a_missing_or_damaged_file_is_named(tmp_path):
    with pytest.raises(InputError, match="nothing.pkl: no such file; expected anything"):
        read(tmp_path / "nothing.pkl")
    whole = pickle.dumps({"a": ARRAY, "b": [1, 2]})
    for end in range(len(whole)):
        with pytest.raises(InputError, match="file.pkl: (damaged|holds).*expected anything"):
            reread(tmp_path, whole[:end])
