"""A seeded generator of damaged files.

Half of them have damaged bytes, as from disks and networks. The others are whole files of their
format with hostile content: arrays of other kinds and shapes, missing keys, numbers that are not
finite, headers that claim 100 GB.
"""

import gzip
import io
import json
import pickle
import re
import struct
import zipfile
import zlib

import numpy as np

CLAIMED = 12_500_000_000  # float64: 100 GB
HOSTILE = (
    None, True, -1, 0, 1.5, 10**30, -(10**30), 2**31, 2**63, float("nan"), float("inf"), 1e308, "",
    "x" * 5000, "../../../etc/passwd", "\x1b[2J", "nan", [], {}, [[]], [None], {"a": 1},
    [[1, [2, [3]]]], b"\xff\xfe",
)  # fmt: skip
OTHER_WORDS = (b"", b"nan", b"1e999", b"-1", b"9" * 30, b"\xff", b"x" * 300)
WIDE = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\x00\x00")


def mutated(rng, name, data, strangers):
    """Return other bytes for a file.

    Args:
        rng: a ``random.Random``.
        name: of the file; its suffix tells the format.
        data: what it holds.
        strangers: contents of other files.
    """
    ways = BY_SUFFIX.get(name[name.rfind(".") :].lower())
    if ways is not None and rng.random() < 0.5:
        return ways(rng, data)
    way = rng.choice((flip, flip, cut, cut, widen, widen, delete, insert, None))
    return (
        rng.choice([b"", b"\n", rng.randbytes(300), *strangers]) if way is None else way(rng, data)
    )


def flip(rng, data):
    """Some bits, in one place or all over."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 40))):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def cut(rng, data):
    return data[: rng.choice((rng.randrange(len(data) + 1), len(data) - 1, 64, 9))]


def widen(rng, data):
    """A number of four bytes, most often in the head, becomes one of the largest."""
    k = rng.randrange(min(len(data), rng.choice((64, 512, 1 << 30))) or 1)
    return data[:k] + rng.choice(WIDE) + data[k + 4 :]


def delete(rng, data):
    k = rng.randrange(len(data) + 1)
    return data[:k] + data[k + rng.randint(1, 64) :]


def insert(rng, data):
    k = rng.randrange(len(data) + 1)
    return data[:k] + rng.randbytes(rng.randint(1, 16)) + data[k:]


OTHER_SHAPES = (
    lambda rng, x: x[..., None],
    lambda rng, x: x.ravel(),
    lambda rng, x: x[:0] if x.ndim else np.zeros((0,)),
    lambda rng, x: np.concatenate([x, x]) if x.ndim else np.stack([x, x]),
    lambda rng, x: x[: rng.randint(1, 3)] if x.ndim else x[None],
    lambda rng, x: x.T,
    lambda rng, x: np.array(rng.choice((3, -1, 2.5, "text", np.nan))),
    lambda rng, x: np.array([{"a": 1}, None], object),
    lambda rng, x: np.zeros(3, [("a", "f4"), ("b", "i2")]),
)


def other_array(rng, x):
    """An array of another kind, shape or content."""
    x = np.array(x)
    if x.dtype.kind not in "fiub" or not x.size or rng.random() < 0.7:
        return rng.choice(OTHER_SHAPES)(rng, x)
    if x.dtype.kind == "b" or rng.random() < 0.3:
        return x.astype(rng.choice(("i1", "u1", "i8", "f2", "f8", "c16", "U4", "S3", "?", ">f8")))
    x = x.astype(np.float64)
    first, last = rng.randrange(x.size), rng.choice((None, rng.randrange(x.size) + 1))
    x.reshape(-1)[first:last] = rng.choice((np.nan, np.inf, -1e308, 1e30, -7, 2**31 - 1))
    return x


def npy(rng, data):
    x = np.load(io.BytesIO(data), allow_pickle=True)
    if x.dtype.hasobject and not x.ndim:
        return as_npy(np.array(other_tree(rng, x.item()), object), rng)
    return as_npy(other_array(rng, x), rng)


def as_npy(x, rng):
    """A .npy, whose header may claim what is not there."""
    file = io.BytesIO()
    np.save(file, x, allow_pickle=True)
    data = file.getvalue()
    if rng.random() < 0.2:
        claim = rng.choice(
            (f"({CLAIMED},)", f"({CLAIMED}, 3)", "(-1,)", "(0, 99999999999)", "((3))")
        )
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {claim}, }}".encode()
        head += b" " * (118 - len(head) - 1) + b"\n"
        data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data[128:]
    return data


def npz(rng, data):
    """Another zip: of other arrays, without some, with more, or packed a thousand times."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    name = rng.choice(list(entries))
    way = rng.randrange(8)
    if way == 0:
        del entries[name]
    elif way == 1:
        entries[name] = rng.choice(list(entries.values()))
    elif way == 2:
        entries[name] = bytes(1 << 24)
    elif way == 3:
        entries[name] = flip(rng, entries[name])
    else:
        entries[name] = npy(rng, entries[name]) if name.endswith(".npy") else b"?"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", rng.choice((0, zipfile.ZIP_DEFLATED))) as file:
        for key, content in entries.items():
            file.writestr(key, content)
    return out.getvalue()


def other_tree(rng, value):
    """Nested dictionaries and lists in which one leaf, key or branch is another."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        value = dict(value)
        if rng.random() < 0.2:
            del value[key]
        else:
            value[key] = other_tree(rng, value[key])
        return value
    if isinstance(value, list | tuple) and value and rng.random() < 0.8:
        k, value = rng.randrange(len(value)), list(value)
        value[k] = other_tree(rng, value[k])
        return value
    if isinstance(value, np.ndarray) and rng.random() < 0.8:
        return other_array(rng, value)
    if type(value).__module__ == "torch" and rng.random() < 0.8:
        import torch

        other = other_array(rng, value.detach().numpy())
        return torch.from_numpy(np.array(other, np.float32)) if other.dtype.kind in "fiu" else [1]
    return rng.choice(HOSTILE)


def text(rng, data):
    """Numbers, words and lines of a text become others."""
    words = re.split(rb"([\s,\[\]:]+)", data)
    for _ in range(rng.choice((1, 1, 5))):
        k = rng.randrange(len(words))
        words[k] = rng.choice((*OTHER_WORDS, words[k] * 2))
    return b"".join(words)


def of_json(rng, data):
    if rng.random() < 0.1:
        return rng.choice(
            (b"[" * 100_000, b'{"a":' * 50_000, b"1" * 5000, b"NaN", b'"', b"\xff\xfe{")
        )
    if rng.random() < 0.2:
        return text(rng, data)
    value = other_tree(rng, json.loads(data))
    return json.dumps(value, default=lambda x: "bytes").encode()


def pickled(rng, data):
    return pickle.dumps(other_tree(rng, pickle.loads(data)), rng.choice((2, 4)))


def of_torch(rng, data):
    import torch

    out = io.BytesIO()
    torch.save(other_tree(rng, torch.load(io.BytesIO(data), weights_only=False)), out)
    return out.getvalue()


def png(rng, data):
    """A PNG whose head says otherwise, with a sum that is right."""
    if data[:4] != b"\x89PNG":
        return flip(rng, data)
    side = lambda: rng.choice((0, 1, 7, 65_535, 100_000, 2**31 - 1))
    depth, kind = rng.choice((1, 2, 8, 16, 3)), rng.choice((0, 2, 3, 4, 6, 1))
    head = b"IHDR" + struct.pack(">IIBBBBB", side(), side(), depth, kind, 0, 0, rng.choice((0, 1)))
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


def spz(rng, data):
    """Bytes below the compression; most of it depends on a header of 16 bytes."""
    if data[:2] != b"\x1f\x8b":
        return widen(rng, data)
    way = rng.choice((flip, widen, cut, delete, insert))
    return gzip.compress(way(rng, gzip.decompress(data)), mtime=0)


def ply(rng, data):
    head, end, body = data.partition(b"end_header\n")
    return text(rng, head) + end + body


BY_SUFFIX = {
    ".npy": npy, ".npz": npz, ".json": of_json, ".pkl": pickled, ".pk": pickled, ".pt": of_torch,
    ".pth": of_torch, ".png": png, ".ply": ply, ".spz": spz, ".txt": text, ".yml": text,
    ".yaml": text,
}  # fmt: skip
