"""A seeded generator of damaged files.

Half of them have damaged bytes, as from disks and networks. The others are whole files of their
format with hostile content: arrays of other kinds and shapes, missing keys, numbers that are not
finite, headers that claim 100 GB.
"""

import io
import json
import pickle
import re
import struct
import zipfile

import numpy as np

HOSTILE = (
    None, True, -1, 1.5, 10**30, 2**63, float("nan"), float("inf"), 1e308, "", "x" * 5000,
    "../../../etc/passwd", "\x1b[2J", [], {}, [[]], [None], {"a": 1}, [[1, [2, [3]]]], b"\xff\xfe",
)  # fmt: skip
WIDE = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\x00\x00")
WORDS = (b"", b"nan", b"1e999", b"-1", b"9" * 30, b"\xff", b"x" * 300)
OTHERS = (
    lambda x: x[..., None], np.ravel, lambda x: x.ravel()[:0], lambda x: np.stack([x, x]),
    lambda x: x[:1] if x.ndim else x[None], lambda x: x.T, lambda x: np.array("text"),
    lambda x: np.array(np.nan), lambda x: np.array([{"a": 1}, None], object),
    lambda x: np.zeros(3, [("a", "f4"), ("b", "i2")]), lambda x: x.astype("U4"),
    lambda x: x.astype("c16"), lambda x: x.astype(">f8"), lambda x: x * np.float64(1e300),
    lambda x: x * np.nan,
)  # fmt: skip


def mutated(rng, name, data, strangers):
    """Return other bytes for a file.

    Args:
        rng: a ``random.Random``.
        name: of the file; its suffix tells the format.
        data: what it holds.
        strangers: contents of other files.
    """
    way = BY_SUFFIX.get(name[name.rfind(".") :].lower())
    if way is not None and rng.random() < 0.5:
        return way(rng, data)
    return rng.choice((flip, flip, cut, cut, widen, insert))(rng, data) or rng.choice(strangers)


def flip(rng, data):
    """Some bits, in one place or all over."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 40))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def cut(rng, data):
    return data[: rng.choice((rng.randrange(len(data)), len(data) - 1, 64, 9, 0))]


def widen(rng, data):
    """A number of four bytes, most often in the head, becomes one of the largest."""
    k = rng.randrange(min(len(data), rng.choice((64, 512, 1 << 30))))
    return data[:k] + rng.choice(WIDE) + data[k + 4 :]


def insert(rng, data):
    """Some bytes more, or others."""
    k = rng.randrange(len(data) + 1)
    return data[:k] + rng.randbytes(rng.randint(0, 16)) + data[k + rng.choice((0, 0, 9, 64)) :]


def other_array(rng, x):
    """An array of another kind, shape or content."""
    x = np.asarray(x)
    return rng.choice(OTHERS)(x if x.dtype.kind in "fiub" else np.zeros((2, 2)))


def npy(rng, data):
    """A .npy, whose header may claim what is not there."""
    file = io.BytesIO()
    np.save(file, other_array(rng, np.load(io.BytesIO(data), allow_pickle=True)))
    if rng.random() < 0.8:
        return file.getvalue()
    claim = rng.choice(("(12500000000,)", "(12500000000, 3)", "(-1,)", "(0, 99999999999)"))
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {claim}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode()


def npz(rng, data):
    """Another zip: of other arrays, without one, or with one that unfolds to 16 MB."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    name = rng.choice(list(entries))
    ways = (lambda x: None, lambda x: bytes(1 << 24), lambda x: flip(rng, x), lambda x: b"?")
    entries[name] = rng.choice((*ways, *4 * [lambda x: npy(rng, x)]))(entries[name])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for key, content in entries.items():
            if content is not None:
                file.writestr(key, content)
    return out.getvalue()


def other_tree(rng, value):
    """Nested dictionaries and lists in which one leaf, key or branch is another."""
    if isinstance(value, dict | list | tuple) and value and rng.random() < 0.9:
        value = dict(value) if isinstance(value, dict) else list(value)
        key = rng.choice(list(value) if isinstance(value, dict) else range(len(value)))
        if rng.random() < 0.2:
            del value[key]
        else:
            value[key] = other_tree(rng, value[key])
        return value
    if isinstance(value, np.ndarray) and rng.random() < 0.8:
        return other_array(rng, value)
    return rng.choice(HOSTILE)


def text(rng, data):
    """Numbers, words and lines of a text become others."""
    words = re.split(rb"([\s,\[\]:]+)", data)
    for _ in range(rng.choice((1, 1, 5))):
        k = rng.randrange(len(words))
        words[k] = rng.choice((*WORDS, words[k] * 2))
    return b"".join(words)


def of_json(rng, data):
    if rng.random() < 0.1:
        return rng.choice((b"[" * 100_000, b'{"a":' * 50_000, b"1" * 5000, b"NaN", b"\xff\xfe{"))
    return json.dumps(other_tree(rng, json.loads(data)), default=lambda x: "bytes").encode()


def pickled(rng, data):
    return pickle.dumps(other_tree(rng, pickle.loads(data)), rng.choice((2, 4)))


def ply(rng, data):
    head, end, body = data.partition(b"end_header\n")
    return text(rng, head) + end + body


BY_SUFFIX = {".npy": npy, ".npz": npz, ".json": of_json, ".pkl": pickled, ".ply": ply, ".txt": text}
