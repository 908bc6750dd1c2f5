"""Hostile files run no code, allocate nothing for a mere claim, and are refused in one sentence."""

import os
import pickle
import resource
import struct
import zlib

import numpy as np
import pytest

from gva_mi.core import arrays as budget
from gva_mi.core.errors import InputError
from gva_mi.core.pickles import reader
from gva_mi.core.pickles.reader import read_objects


def named(module, name, *args, op=b"R"):
    """A pickle that calls any name at all, which need not exist here."""
    return b"c" + f"{module}\n{name}\n".encode() + pickle.dumps(args, 2)[2:-1] + op + b"."


CALLS = (
    ("posix", "system", "touch ran"),
    ("__builtin__", "exec", "open('ran', 'w')"),
    ("builtins", "getattr", "a", "upper"),
    ("numpy.testing._private.utils", "runstring", "open('ran', 'w')", {}),
    ("numpy", "memmap", "ran", "u1", "w+"),
    ("torch", "load", "x.pt"),
    ("builtins", "object.__class__", "x"),
    ("gva_mi.core.pickles.reader", "read_objects", "x", "y"),
)


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


def test_a_name_that_is_not_allowed_is_refused(refuse):
    for module, function, *args in CALLS:
        home = {"__builtin__": "builtins"}.get(module, module)
        for op in (b"R", b"\x81"):  # REDUCE and NEWOBJ
            evil = named(module, function, *args, op=op)
            refuse(evil, f"holds (a call of )?{home}.{function}, which is not read")


def test_every_protocol_and_every_opcode_that_calls_is_refused(refuse):
    class Evil:
        def __reduce__(self):
            return os.system, ("touch ran",)

    for protocol in range(6):
        refuse(pickle.dumps([np.zeros(2), Evil()], protocol), "holds (posix|nt).system")
    refuse(b"(S'touch ran'\nios\nsystem\n.", "holds os.system")
    refuse(b"(cos\nsystem\nS'touch ran'\no.", "holds os.system")
    refuse(b"\x80\x02\x82\x01.", "unregistered extension code 1")
    refuse(b"P42\n.", "holds a reference to something outside the file")
    refuse(b"\x80\x05\x97.", "damaged.*buffer")


def test_allowed_names_cannot_be_misused(refuse):
    """They take no state, cannot be called otherwise, and are no values."""
    dtype = b"cnumpy\ndtype\n"
    refuse(dtype + b".", "holds numpy.dtype as a value")
    refuse(b"\x80\x04\x8c\x04\x1b[a\n\x8c\x01c\x93.", r"holds  \[a .c, which")
    refuse(dtype + b"}S'x'\nI1\nsb.", "damaged")
    refuse(dtype + b"N}S'value'\nI1\ns\x86b.", "damaged")
    refuse(b"c_codecs\nencode\nN}S'make'\nI1\ns\x86b.", "holds a state for _codecs.encode")
    refuse(b"c_codecs\nencode\n}S'x'\nI1\nsb.", "holds a state for _codecs.encode")
    refuse(b"cnumpy\nndarray\n(I9\ntR.", "holds a call of numpy.ndarray")
    refuse(b"]cbuiltins\nlist\n(tR.", "holds a call of builtins.list")
    refuse(b"](I1\ntR.", r"damaged.*\(something in it is of another kind\)")
    refuse(b"]}S'x'\nI1\nsb.", "damaged")
    refuse(dtype + b"(S'V8'\ntR.", "holds an array of dtype 'V8'")
    refuse(pickle.dumps(np.zeros(2, [("a", "f4")])), "holds (a structured|an array of dtype 'V4')")
    scalar = b"cnumpy.core.multiarray\nscalar\n(" + dtype + b"(S'O8'\ntR]tR."
    refuse(scalar, "holds numpy.core.multiarray.scalar of an object")
    other = b"cnumpy.core.multiarray\n_reconstruct\n(cbuiltins\nobject\n(I0\ntS'b'\ntR."
    refuse(other, "holds an array of class ")
    refuse(b"ccopyreg\n_reconstructor\n(cbuiltins\nobject\ncbuiltins\nobject\nNtR.", "an instance")
    refuse(b"c_codecs\nencode\n(S'a'\nS'rot13'\ntR.", "holds _codecs.encode to rot13")


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
    """Allow this process 2 GiB more than it has, and check that it takes less than 256 MiB."""
    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    before, used = resource.getrlimit(resource.RLIMIT_AS), peak()
    with open("/proc/self/statm") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + (2 << 30), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)
    assert peak() - used < 1 << 18, "kB"


def test_a_claim_of_100_gigabytes_allocates_nothing(refuse, little_memory):
    size = 100 * 10**9
    refuse(array((size // 8,)), "an array claims 100,000,000,000 bytes, but holds 0")
    refuse(array((size // 8,), "O8", [None]), "an array claims 12,500,000,000 bytes, but holds 1")
    for opcode in (b"\x80\x04\x8e", b"\x80\x05\x96", b"\x80\x04\x8d"):
        refuse(opcode + struct.pack("<Q", size) + b"x", "damaged")
    refuse(b"]r\x00\x00\x00\x0f].", "damaged.*LONG_BINPUT")


def test_tensors_and_sparse_matrices_that_claim_too_much(refuse, little_memory):
    import torch

    data, count = pickle.dumps(torch.zeros(300)), b"M" + struct.pack("<H", 300)
    refuse(data.replace(count, b"J" + struct.pack("<i", 2**31 - 1)), "damaged|a tensor of size")
    wide = pickle.dumps(torch.zeros(1).expand(2**31 - 1, 1000))
    refuse(wide, "contents that unfold to more than 4 GiB")
    csr = pytest.importorskip("scipy.sparse").csr_matrix
    for indptr in ([0, 2**31 - 1, 3], [0, -(2**31), 3], [0, 1, 2]):
        sparse = csr(np.ones((2, 3)) * [[1], [0]])
        sparse.indptr = np.array(indptr, np.int64)
        refuse(pickle.dumps(sparse), "rows claim other numbers than there are")
    sparse = csr((2, 3))
    sparse._shape = (2**31 - 1, 2)
    refuse(pickle.dumps(sparse), "contents that unfold to more than 4 GiB")


def test_contents_that_unfold_beyond_the_budget(refuse, monkeypatch):
    monkeypatch.setattr(budget.Budget.__init__, "__defaults__", (1 << 20,))
    monkeypatch.setattr(reader, "LARGEST", 3 << 20)
    refuse(zlib.compress(bytes(1 << 22)), "damaged.*compressed data")
    refuse(zlib.compress(pickle.dumps(np.zeros(99)))[:-9], "compressed data end too early")
    places, one = (pickle.dumps(x, 2)[2:-1] for x in (np.zeros(30_000, int), np.ones(1)))
    select = b"cchumpy.reordering\nSelect\n)\x81}(U\x01a" + one + b"U\x04idxs" + places + b"ub"
    refuse(b"\x80\x02](" + 9 * select + b"e.", "contents that unfold to more than")
    size = 1 << 16
    once = array((size // 8,), data=b"\x01" * size)[2:-1]
    at = once.index(b"\x01" * size) + size  # remember the bytes, and make more arrays of them
    again = once[: at - size - 5] + b"h\x63" + once[at:]
    refuse(b"\x80\x02](" + once[:at] + b"q\x63" + once[at:] + again * 40 + b"e.", "contents that")


def test_what_would_take_forever(refuse):
    """Tuples that share their parts, whose hash takes 2⁶⁰ steps; lists nested 100,000 deep."""
    shared = b"\x80\x02)" + b"2\x86" * 60
    refuse(shared + b"}" + shared[2:] + b"I1\ns.", "damaged.*DUP")
    refuse(b"]" * 100_000 + b"a" * 99_999 + b".", "damaged.*nested too deeply")
