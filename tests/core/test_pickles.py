"""Other people's files give plain arrays; hostile ones run no code and get one sentence."""

import gzip
import os
import pickle
import struct
import zlib
from collections import OrderedDict, defaultdict
from pathlib import Path

import numpy as np
import pytest
from samples.joblib_files import joblib_dump

from gva_mi.core.errors import InputError
from gva_mi.core.pickles import ALLOWED, read_objects

ARRAY = np.arange(12, dtype=np.float32).reshape(3, 4)


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Read the bytes of a file; whatever they are, nothing is run."""
    monkeypatch.chdir(tmp_path)

    def of(data, suffix=".pkl"):
        path = tmp_path / f"file{suffix}"
        path.write_bytes(data)
        try:
            return read_objects(path, "anything")
        finally:
            assert not Path("ran").exists()

    return of


@pytest.mark.parametrize("protocol", range(6))
def test_every_protocol(read, protocol):
    value = {"c": ARRAY, "f": np.asfortranarray(ARRAY), "none": None, "again": ARRAY,
        "scalar": np.int64(7), "text": np.array(["male", "x"]), "bytes": np.array(b"male"),
        "bool": np.array([True, False]), "empty": np.zeros((0, 3)), "zero": np.array(2.5),
        "ordered": OrderedDict(a=1), "default": defaultdict(list, b=[2]), "set": {1, "a"},
        np.int64(3): (1, 2.5, "ü", b"\xff\x00", b"", 10**30, 1j, True)}  # fmt: skip
    found = read(pickle.dumps(value, protocol))
    assert list(found) == list(value)
    for key, wanted in value.items():
        if isinstance(wanted, np.ndarray):
            assert found[key].dtype == wanted.dtype and np.array_equal(found[key], wanted), key
            assert type(found[key]) is np.ndarray and found[key].flags.writeable
        else:
            assert found[key] == wanted, key


def test_what_python_2_wrote(read):
    """Protocol 0, with text as latin-1 strings, and numpy's names as they were."""
    code = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
    code += b"(I1\n(I2\ntcnumpy\ndtype\n(S'f4'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\n"
    code += b"S'\\x00\\x00\\x80?\\x00\\x00\\x00@'\ntb."
    assert read(code).tolist() == [1, 2]


def test_objects_in_arrays(read, tmp_path):
    value = np.array([[{"a": ARRAY}, None]], dtype=object)
    found = read(pickle.dumps(value))
    assert found.shape == (1, 2) and np.array_equal(found[0, 0]["a"], ARRAY)
    np.savez(tmp_path / "romp.npz", results={"cam": ARRAY}, frames=ARRAY)
    found = read((tmp_path / "romp.npz").read_bytes(), ".npz")
    assert np.array_equal(found["results"].item()["cam"], ARRAY)
    assert np.array_equal(found["frames"], ARRAY)


@pytest.mark.parametrize("pack", [bytes, zlib.compress, gzip.compress], ids=["plain", "zlib", "gz"])
def test_joblib(read, pack):
    value = {np.int64(0): {"pose": ARRAY, "again": ARRAY, "f": np.asfortranarray(ARRAY * 2)}}
    value["objects"] = np.array([{"a": 1}, None], dtype=object)
    found = read(pack(joblib_dump(value)))
    person = found[0]
    assert np.array_equal(person["pose"], ARRAY) and np.array_equal(person["again"], ARRAY)
    assert np.array_equal(person["f"], ARRAY * 2) and found["objects"][0] == {"a": 1}


@pytest.mark.parametrize("zipped", [True, False])
def test_tensors(tmp_path, zipped):
    import torch

    tensor = torch.arange(12.0).reshape(3, 4)
    value = {
        "t": tensor, "view": tensor[1:, ::2], "turned": tensor.T, "half": tensor.bfloat16(),
        "long": torch.arange(3), "p": torch.nn.Parameter(tensor), "wide": tensor[:1].expand(5, 4),
    }  # fmt: skip
    path = tmp_path / "file.pt"
    torch.save({"inner": [value], "n": 3}, path, _use_new_zipfile_serialization=zipped)
    found = read_objects(path, "anything")
    assert found["n"] == 3
    for key, array in found["inner"][0].items():
        assert np.array_equal(array, value[key].detach().float().numpy()), key
    torch.save(value | {"a": Path("evil")}, path, _use_new_zipfile_serialization=zipped)
    with pytest.raises(InputError, match="holds objects that are no tensors, which is not read"):
        read_objects(path, "anything")


@pytest.mark.parametrize("protocol", (0, 2, 5))
@pytest.mark.parametrize("form", ("csc_matrix", "csr_matrix"))
def test_sparse_matrices(read, form, protocol):
    sparse = getattr(pytest.importorskip("scipy.sparse"), form)(ARRAY * (ARRAY > 3))
    assert np.array_equal(read(pickle.dumps(sparse, protocol)), ARRAY * (ARRAY > 3))
    sparse.indices = sparse.indices + 2**30
    with pytest.raises(InputError, match="damaged"):
        read(pickle.dumps(sparse, protocol))


def chumpy(name, state):
    """A chumpy object as protocol 2 writes it: its class, no arguments, its dictionary."""
    module = {"Ch": "chumpy.ch", "Select": "chumpy.reordering"}[name]
    return b"c" + f"{module}\n{name}\n".encode() + b")\x81q\x63" + state + b"b"


def test_arrays_of_chumpy(read):
    state = pickle.dumps({"x": ARRAY, "_dirty_vars": set(), "_itr": None}, 2)[2:-1]
    whole = chumpy("Ch", state)
    assert np.array_equal(read(b"\x80\x02]" + whole + b"ah\x63a.")[1], ARRAY)  # also remembered
    # Its selection of elements names another chumpy array in its state.
    state = b"}(U\x01a" + whole + b"U\x04idxs" + pickle.dumps(np.array([4, 0]), 2)[2:-1] + b"u"
    assert read(b"\x80\x02" + chumpy("Select", state) + b".").tolist() == [4, 0]


class Evil:
    def __reduce__(self):
        return os.system, ("touch ran",)


def named(module, name, *args, op=b"R"):
    """A pickle that calls any name at all, which need not exist here."""
    return b"c" + f"{module}\n{name}\n".encode() + pickle.dumps(args, 2)[2:-1] + op + b"."


CALLS = (("posix", "system", "touch ran"), ("__builtin__", "exec", "open('ran', 'w')"),
    ("builtins", "getattr", "a", "upper"), ("torch", "load", "x.pt"),
    ("numpy.testing._private.utils", "runstring", "open('ran', 'w')", {}),
    ("builtins", "object.__class__", "x"), ("builtins", "open", "ran", "w"),
    ("gva_mi.core.pickles", "read_objects", "x", "y"))  # fmt: skip
DTYPE = b"cnumpy\ndtype\n"
HOSTILE = {
    **{f"{module}.{name} by {op}": (named(module, name, *args, op=op), f"holds {module}.{name}, ")
       for module, name, *args in CALLS for op in (b"R", b"\x81")},
    **{f"reduced, protocol {k}": (pickle.dumps([ARRAY, Evil()], k), "holds (posix|nt).system")
       for k in range(6)},
    "inst": (b"(S'touch ran'\nios\nsystem\n.", "holds os.system"),
    "obj": (b"(cos\nsystem\nS'touch ran'\no.", "holds os.system"),
    "extension": (b"\x80\x02\x82\x01.", "unregistered extension code 1"),
    "outside": (b"P42\n.", "damaged.*persistent"),
    "buffer": (b"\x80\x05\x97.", "damaged.*buffer"),
    "name of control characters": (b"\x80\x04\x8c\x04\x1b[a\n\x8c\x01c\x93.", r"holds  \[a .c,"),
    "memory map": (named("numpy", "memmap", "ran", "u1", "w+"), "damaged"),
    "array by call": (named("numpy", "ndarray", 9), "damaged"),
    "call of a list": (b"](I1\ntR.", r"damaged.*\(a value has the wrong type\)"),
    "state of a list": (b"]}S'x'\nI1\nsb.", "holds a state for "),
    "state of a type": (DTYPE + b"}S'x'\nI1\nsb.", "holds a state for <function"),
    "state of a function": (b"c_codecs\nencode\n}S'x'\nI1\nsb.", "holds a state for <function"),
    "defaults of a function": (b"c_codecs\nencode\nN}S'__defaults__'\nI1\ns\x86b.", "a state for"),
    "structured dtype": (DTYPE + b"(S'V8'\ntR.", "holds an array of dtype 'V8'"),
    "structured array": (pickle.dumps(np.zeros(2, [("a", "f4")])), "an array of dtype 'V4'"),
    "big-endian array": (pickle.dumps(ARRAY.astype(">f8")), "holds big-endian numbers"),
    "scalar of an object":
        (b"cnumpy\nscalar\n(" + DTYPE + b"(S'O8'\ntRS'12345678'\ntR.", "damaged"),
    "reconstructed object":
        (b"ccopyreg\n_reconstructor\n(cbuiltins\nobject\ncbuiltins\nobject\nNtR.", "an instance"),
    "codec": (b"c_codecs\nencode\n(S'a'\nS'rot13'\ntR.", "holds _codecs.encode to rot13"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_no_code_of_a_file_runs(read, name):
    data, match = HOSTILE[name]
    with pytest.raises(InputError, match=match):
        read(data)


def test_nothing_that_is_allowed_reaches_further():
    """Types of Python, and functions and classes of this module."""
    ours = lambda x: isinstance(x, str) or x.__module__ == "gva_mi.core.pickles"
    others = {x for x in ALLOWED.values() if not ours(x)}
    assert others == {object, bool, int, float, complex, str, list, dict, set, OrderedDict}


def array(shape, dtype="f8", data=b""):
    """A pickled array that claims a shape."""
    return (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        + b"(K\x01" + pickle.dumps(shape, 2)[2:-1] + b"cnumpy\ndtype\nU"
        + bytes([len(dtype)]) + dtype.encode() + b"\x85R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ"
        + b"\xff\xff\xff\xffK\x00tb\x89" + pickle.dumps(data, 3)[2:-1] + b"tb."
    )  # fmt: skip


CLAIMS = {
    "many numbers": array((10**11,)), "negative": array((-1, -2), data=b"1234567890123456"),
    "many objects": array((10**11,), "O8", [None]), "no objects": array((1,), "O8", b"12345678"),
    "bytes for a list": array((1,), "f8", [1.0]),
    "text": b"\x80\x04\x8d" + struct.pack("<Q", 10**11) + b"x",
    "bytes": b"\x80\x04\x8e" + struct.pack("<Q", 10**11) + b"x",
    "nested": b"]" * 100_000 + b"a" * 99_999,
    "compressed": zlib.compress(pickle.dumps(ARRAY))[:-9],
}  # fmt: skip


@pytest.mark.parametrize("name", CLAIMS)
def test_a_false_claim_is_an_error(read, name):
    with pytest.raises(InputError, match="file.pkl: damaged, cut short, or of an unknown kind"):
        read(CLAIMS[name])


def test_a_missing_or_truncated_file_is_named(read, tmp_path):
    with pytest.raises(InputError, match="nothing.pkl: no such file; expected anything"):
        read_objects(tmp_path / "nothing.pkl", "anything")
    whole = pickle.dumps({"a": ARRAY, "b": [1, 2]})
    for end in range(len(whole)):
        with pytest.raises(InputError, match="file.pkl: (damaged|holds).*expected anything"):
            read(whole[:end])
