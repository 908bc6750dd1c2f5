"""Read the arrays and plain values of a file in any common container: :func:`read_objects`.

It reads pickles of protocols 0 to 5 and files of ``joblib.dump``, both also packed by zlib or gzip;
torch's files, old and new; ``.npy`` and ``.npz``, with or without objects.
"""

from __future__ import annotations

import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

from gva_mi.core.arrays import LARGEST, Budget, Damaged, Refused, arrays_in, read_entry, read_npy
from gva_mi.core.containers import known_container
from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.files import require_file
from gva_mi.core.pickles.unpickler import require_modest, resolve
from gva_mi.core.pickles.values import load, load_row_of_pickles, storage_of

_ROW_OF_PICKLES = b"\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."  # torch's magic number, pickled


def read_objects(path: Path, expected: str) -> Any:  # noqa: ANN401
    """Read a file's dictionaries, lists, text, numbers and arrays.

    Tensors, sparse matrices and chumpy's arrays become plain arrays. No code of the file runs.
    ``expected`` says in the error what it should hold.
    """
    path = Path(path)
    require_file(path, expected)
    budget = Budget()
    try:
        return resolve(_load(path), budget)
    except Refused as error:
        raise InputError(
            f"{path}: holds {error}, which is not read because it may run code or is no plain "
            f"array; expected {expected}"
        ) from None
    except Exception as error:  # a damaged file can fail in any opcode, and in any way
        if kind := known_container(path):
            raise InputError(f"{path}: {kind}; expected {expected}") from None
        raise InputError(
            f"{path}: damaged, cut short, or of another kind ({reason_of(error)}); expected "
            f"{expected}"
        ) from None


def _load(path: Path) -> Any:  # noqa: ANN401
    """Return the root object, in which arrays may still be shells."""
    if path.stat().st_size > 2 * LARGEST:
        raise Refused(f"{path.stat().st_size:,} bytes")
    with path.open("rb") as file:
        zipped = file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")  # the second: an empty one
    if zipped:
        entries = Budget()  # apart from the budget of what is made of them
        with zipfile.ZipFile(path) as file:
            if any(name.rsplit("/")[-1] == "data.pkl" for name in file.namelist()):
                return _tensors(file, entries)
            return {name: read_npy(data, _pickle) for name, data in arrays_in(file, entries)}
    data = path.read_bytes()
    if data[:1] == b"\x78" or data[:2] == b"\x1f\x8b":
        packed = zlib.decompressobj(wbits=47)
        data = packed.decompress(data, LARGEST)
        if not packed.eof:
            raise Damaged(f"compressed data end too early, or hold more than {LARGEST >> 30} GiB")
    if data[:6] == b"\x93NUMPY":
        return read_npy(data, _pickle)
    if _ROW_OF_PICKLES in data[:32]:
        return load_row_of_pickles(data)
    return _pickle(data)


def _pickle(data: bytes) -> Any:  # noqa: ANN401
    if b"NumpyArrayWrapper" not in data:  # joblib has the bytes of arrays between opcodes
        require_modest(data)
    try:
        return load(BytesIO(data))
    except MemoryError:  # which it takes for whatever a damaged length claims
        raise Damaged("it claims more bytes than there is memory") from None


def _tensors(file: zipfile.ZipFile, budget: Budget) -> Any:  # noqa: ANN401
    """Read torch's newer container, a zip with one file a storage."""
    read = lambda name: read_entry(file, name, budget)
    pickled = next(name for name in file.namelist() if name.rsplit("/")[-1] == "data.pkl")
    folder = pickled[: -len("data.pkl")]
    if f"{folder}byteorder" in file.namelist() and read(f"{folder}byteorder") != b"little":
        raise Refused("tensors in big-endian order")
    found, data = {}, read(pickled)
    require_modest(data)
    root = load(BytesIO(data), lambda pid: storage_of(found, pid))
    for key, storage in found.items():
        storage.state = read(f"{folder}data/{key}")
    return root
