"""Hostile files: no code runs, nothing is allocated for a mere claim, and the name is said."""

import os
import pickle
import random
import resource
import struct
import zipfile
import zlib

import numpy as np
import pytest

from gva_mi.core import arrays as budget
from gva_mi.core.errors import InputError
from gva_mi.core.pickles.reader import read_objects


class Call:
    """Pickles as a call of a function."""

    def __init__(self, function, *args):
        self.call = function, args

    def __reduce__(self):
        return self.call


def named(module, name, *args, op=b"R"):
    """A call of any name at all, which need not exist here."""
    return b"c" + f"{module}\n{name}\n".encode() + pickle.dumps(args, 2)[2:-1] + op + b"."


CALLS = {
    "os.system": ("posix", "system", "touch ran"),
    "eval": ("builtins", "eval", "open('ran', 'w')"),
    "exec": ("__builtin__", "exec", "open('ran', 'w')"),
    "getattr": ("builtins", "getattr", "a", "upper"),
    "open": ("builtins", "open", "ran", "w"),
    "import": ("builtins", "__import__", "os"),
    "partial": ("functools", "partial", "a"),
    "attrgetter": ("operator", "attrgetter", "__class__"),
    "popen": ("subprocess", "Popen", "touch ran"),
    "load": ("pickle", "loads", b"."),
    "numpy load": ("numpy", "load", "x.npy"),
    "numpy exec": ("numpy.testing._private.utils", "runstring", "open('ran', 'w')", {}),
    "numpy fromfile": ("numpy", "fromfile", "/etc/passwd"),
    "numpy f2py": ("numpy.f2py.crackfortran", "myeval", "open('ran', 'w')"),
    "numpy memmap": ("numpy", "memmap", "ran", "u1", "w+"),
    "torch load": ("torch", "load", "x.pt"),
    "torch hub": ("torch.hub", "load", "a", "b"),
    "torch jit": ("torch.jit", "load", "x"),
    "scipy": ("scipy.sparse", "load_npz", "x"),
    "joblib": ("joblib", "load", "x"),
    "dotted": ("builtins", "object.__class__", "x"),
    "type": ("builtins", "type", "x", (), {}),
    "map": ("builtins", "map", "x", []),
    "site": ("code", "interact"),
    "own": ("gva_mi.core.pickles.reader", "read_objects", "x", "y"),
}


@pytest.fixture
def refuse(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def check(data, match, suffix=".pkl"):
        path = tmp_path / f"evil{suffix}"
        path.write_bytes(data)
        with pytest.raises(InputError, match=match) as caught:
            read_objects(path, "arrays")
        assert "\n" not in str(caught.value) and not os.path.exists("ran")

    return check


@pytest.fixture
def written(tmp_path):
    def write(data):
        path = tmp_path / "tame.pkl"
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("op", [b"R", b"\x81"], ids=["reduce", "newobj"])
def test_a_call_is_refused_by_its_name(refuse, name, op):
    module, function, *args = CALLS[name]
    home = {"__builtin__": "builtins"}.get(module, module)
    refuse(named(module, function, *args, op=op), f"holds {home}.{function}, which is not read")


def test_what_pickle_itself_would_run(refuse):
    for protocol in range(6):
        refuse(pickle.dumps(Call(os.system, "touch ran"), protocol), "holds (posix|nt).system")
        refuse(pickle.dumps([np.zeros(2), Call(eval, "1")], protocol), "holds builtins.eval")


def test_old_ways_to_call(refuse):
    refuse(b"(S'touch ran'\nios\nsystem\n.", "holds os.system")
    refuse(b"(cos\nsystem\nS'touch ran'\no.", "holds os.system")
    refuse(b"\x80\x02\x82\x01.", "holds extension code 1")
    refuse(b"P42\n.", "holds a reference to something outside the file")
    refuse(b"\x80\x05\x97.", "holds a buffer outside the file")
    refuse(b"(Nios\nsystem\n.", "holds os.system")


def test_names_that_are_known_may_not_be_misused(refuse):
    """Names with a meaning cannot be called otherwise, given a state, or taken as values."""
    dtype = b"cnumpy\ndtype\n"
    refuse(dtype + b".", "holds numpy.dtype as a value")
    refuse(b"\x80\x04\x8c\x04\x1b[a\n\x8c\x01c\x93.", r"holds \?\[a\?.c, which")
    refuse(dtype + b"}S'x'\nI1\nsb.", "holds a state for numpy.dtype")
    refuse(b"cnumpy\nndarray\n(I9\ntR.", "holds a call of numpy.ndarray")
    refuse(b"]cbuiltins\nlist\n(tR.", "holds a call of builtins.list")
    refuse(b"](I1\ntR.", "holds a call of list")
    refuse(b"]}b.", "holds a state for list")
    refuse(dtype + b"(S'V8'\ntR.", "holds an array of dtype 'V8'")
    refuse(dtype + b"(S'M8'\ntR.", "holds an array of dtype 'M8'")
    refuse(pickle.dumps(np.zeros(2, [("a", "f4")])), "holds (a structured|an array of dtype 'V4')")
    scalar = b"cnumpy.core.multiarray\nscalar\n(" + dtype + b"(S'O8'\ntR]tR."
    refuse(scalar, "holds numpy.core.multiarray.scalar of an object")
    other = b"cnumpy.core.multiarray\n_reconstruct\n(cbuiltins\nobject\n(I0\ntS'b'\ntR."
    refuse(other, "holds an array of class builtins.object")
    refuse(b"ccopyreg\n_reconstructor\n(cbuiltins\nobject\ncbuiltins\nobject\nNtR.", "an instance")
    refuse(b"c_codecs\nencode\n(S'a'\nS'rot13'\ntR.", "holds _codecs.encode to rot13")
    refuse(b"ccollections\ndefaultdict\n(cnumpy\ndtype\ntR.", "holds collections.defaultdict of")


def array(shape, dtype="f8", data=b""):
    """A pickled array that claims a shape."""
    return (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        + b"(K\x01" + pickle.dumps(shape, 2)[2:-1] + b"cnumpy\ndtype\nU"
        + bytes([len(dtype)]) + dtype.encode() + b"\x85R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ"
        + b"\xff\xff\xff\xffK\x00tb\x89" + pickle.dumps(data, 3)[2:-1] + b"tb."
    )  # fmt: skip


@pytest.fixture
def little_memory():
    """No more than 2 GiB beyond what this process has: a claim of 100 GB cannot be met."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + (2 << 30), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def test_a_claim_of_100_gigabytes_allocates_nothing(refuse, little_memory, tmp_path):
    size = 100 * 10**9
    before = peak()
    refuse(array((size // 8,)), "an array claims 100,000,000,000 bytes, but holds 0")
    refuse(array((size // 8,), "O8", [None]), "an array claims 12,500,000,000 bytes, but holds 1")
    refuse(b"\x80\x04\x8e" + struct.pack("<Q", size) + b"x", "100,000,000,000 bytes are claimed")
    refuse(b"\x80\x05\x96" + struct.pack("<Q", size) + b"x", "100,000,000,000 bytes are claimed")
    refuse(b"\x80\x04\x8d" + struct.pack("<Q", size) + b"x", "100,000,000,000 bytes are claimed")
    refuse(b"]r\xff\xff\xff\xff]j\xfe\xff\xff\xff.", "damaged")
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (12500000000,), }"
    header += b" " * (118 - len(header) - 1) + b"\n"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    refuse(npy, "claims 100,000,000,000 bytes, but holds 0", ".npy")
    with zipfile.ZipFile(tmp_path / "evil.npz", "w") as file:
        file.writestr("poses.npy", npy)
    with pytest.raises(InputError, match="claims 100,000,000,000 bytes, but holds 0"):
        read_objects(tmp_path / "evil.npz", "arrays")
    assert peak() - before < 1 << 18, "kB"


def test_a_tensor_that_claims_too_much(refuse, little_memory):
    import torch

    data = pickle.dumps(torch.zeros(300))
    count = b"M" + struct.pack("<H", 300)
    assert data.count(count)
    refuse(data.replace(count, b"J" + struct.pack("<i", 2**31 - 1)), "damaged|a tensor of size")
    wide = pickle.dumps(torch.zeros(1).expand(2**31 - 1, 1000))
    refuse(wide, "contents that unfold to more than 4 GiB")


@pytest.mark.parametrize("indptr", [[0, 2**31 - 1, 3], [0, -(2**31), 3], [0, 1, 2]])
def test_a_sparse_matrix_whose_rows_claim_what_is_not_there(refuse, little_memory, indptr):
    sparse = pytest.importorskip("scipy.sparse").csr_matrix(np.ones((2, 3)) * [[1], [0]])
    sparse.indptr = np.array(indptr, np.int64)
    refuse(pickle.dumps(sparse), "rows claim other numbers than there are")


def test_selections_that_share_their_elements(refuse, tmp_path, monkeypatch):
    monkeypatch.setattr(budget.Budget.__init__, "__defaults__", (1 << 16,))
    places = pickle.dumps(np.zeros(3000, np.int64), 2)[2:-1]
    one = pickle.dumps(np.ones(1), 2)[2:-1]
    select = b"cchumpy.reordering\nSelect\n)\x81}(U\x01a" + one + b"U\x04idxs" + places + b"ub"
    refuse(b"\x80\x02](" + 9 * select + b"e.", "contents that unfold to more than")


def test_what_is_packed_too_densely(refuse, little_memory, tmp_path, monkeypatch):
    monkeypatch.setattr(budget.Budget.__init__, "__defaults__", (1 << 20,))
    refuse(zlib.compress(bytes(1 << 22)), "contents that unfold to more than")
    refuse(zlib.compress(pickle.dumps(np.zeros(99)))[:-9], "the compressed data end too early")
    large = b"J\xff\xff\xff\x7f"
    sparse = b"cscipy.sparse.csc\ncsc_matrix\n)\x81}(U\x06_shape" + large + large + b"\x86"
    sparse += b"U\x04data" + array((0,))[2:-1] + b"U\x07indices" + array((0,), "i4")[2:-1]
    sparse += b"U\x06indptr" + array((0,), "i4")[2:-1] + b"ub."
    refuse(b"\x80\x02" + sparse, "contents that unfold to more than 4 GiB")
    size = 1 << 16
    once = array((size // 8,), data=b"\x01" * size)[2:-1]
    at = once.index(b"\x01" * size) + size  # remember the bytes, and make more arrays of them
    again = once[: at - size - 5] + b"h\x63" + once[at:]
    refuse(b"\x80\x02](" + once[:at] + b"q\x63" + once[at:] + again * 40 + b"e.", "contents that")
    with zipfile.ZipFile(tmp_path / "evil.npz", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.npy", b"\x93NUMPY" + b"\x00" * (1 << 20))
    with pytest.raises(InputError, match="evil.npz: "):
        read_objects(tmp_path / "evil.npz", "arrays")


def test_what_would_take_forever(refuse, written):
    """Tuples that share their parts: hashing or copying them would take 2⁶⁰ steps."""
    shared = b"\x80\x02)" + b"2\x86" * 60
    refuse(shared + b"}" + shared[2:] + b"I1\ns.", "holds a key that is tuple")
    assert len(read_objects(written(shared + b"."), "tuples")) == 2
    deep = b"]" * 100_000 + b"a" * 99_999 + b"."
    refuse(deep, "damaged.*recursion")


def test_thousands_of_damaged_files_end_in_one_sentence(tmp_path, monkeypatch):
    """Bytes flipped, cut and moved in files of every kind; those that still can be read, may be."""
    import torch

    monkeypatch.chdir(tmp_path)
    value = {"a": np.arange(6.0), "t": torch.arange(3.0), "o": np.array([{"x": 1}], object)}
    np.savez(tmp_path / "a.npz", **{k: np.asarray(v) for k, v in value.items()})
    seeds = [pickle.dumps(value, protocol) for protocol in range(6)]
    seeds += [zlib.compress(seeds[4]), (tmp_path / "a.npz").read_bytes()]
    torch.save(value["t"], tmp_path / "t.pt")
    seeds.append((tmp_path / "t.pt").read_bytes())
    rng, refused, path = random.Random(0), 0, tmp_path / "fuzz.pkl"
    for _ in range(500):
        data = bytearray(rng.choice(seeds))
        for _ in range(rng.randint(1, 6)):
            k = rng.randrange(len(data))
            way = rng.randrange(4)
            if way == 0:
                data[k] = rng.randrange(256)
            elif way == 1:
                del data[k : k + rng.randint(1, 9)]
            elif way == 2:
                data[k:k] = rng.randbytes(rng.randint(1, 5))
            else:
                data[k : k + 4] = b"\xff\xff\xff\x7f"
            data = data or bytearray(b"x")
        path.write_bytes(data)
        try:
            read_objects(path, "arrays")
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and str(error).startswith(str(path))
    assert refused > 250
