"""``read_objects``: what any file of arrays and plain values holds, by whichever container it is.

=============================  =====================================================
Container                      Who writes it
=============================  =====================================================
pickle, protocols 0 to 5       ``pickle.dump`` of Python 2 and 3
the same, arrays behind        ``joblib.dump``
zlib, gzip, bzip2, xz around   ``joblib.dump(compress=...)``, ``gzip.open``
zip with ``data.pkl``          ``torch.save``; the row of pickles before it, too
zip of ``.npy``                ``numpy.savez``, arrays of objects included
``.npy``                       ``numpy.save``, arrays of objects included
=============================  =====================================================
"""

from __future__ import annotations

import bz2
import io
import lzma
import zipfile
import zlib
from pathlib import Path
from typing import Any

from gva_mi.core.arrays import (
    LARGEST,
    Budget,
    Damaged,
    Refused,
    arrays_in,
    bytes_to_array,
    read_entry,
    read_header,
)
from gva_mi.core.errors import InputError
from gva_mi.core.pickles.machine import Machine, Stream, resolved
from gva_mi.core.pickles.tensors import TENSORS, read_row_of_pickles, read_zip

_ROW_OF_PICKLES = b"\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."  # torch's magic number, pickled


def read_objects(path: Path, expected: str) -> Any:  # noqa: ANN401
    """What a file holds: dictionaries, lists, text, numbers and arrays, and nothing that runs.

    Tensors, sparse matrices and chumpy's arrays become plain arrays.

    Args:
        path: the file.
        expected: what it should hold, for the error.

    Raises:
        InputError: no such file; damaged; or it holds something that is not on the list, by name.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected {expected}")
    budget = Budget()
    try:
        return resolved(_opened(path, budget), budget)
    except Refused as error:
        raise InputError(
            f"{path}: holds {_printable(str(error))}, which is not read, for it may run code or is "
            f"no plain array; expected {expected}"
        ) from None
    except Exception as error:  # a damaged file can fail in any opcode, and in any way
        reason = _printable(str(error).split("\n")[0] or type(error).__name__)
        raise InputError(
            f"{path}: damaged, cut short, or of another kind ({reason}); expected {expected}"
        ) from None


def _printable(text: str) -> str:
    """A file's own words, without what would move a terminal's cursor."""
    return "".join(c if c.isprintable() else "?" for c in text[:120])


def _opened(path: Path, budget: Budget) -> Any:  # noqa: ANN401
    """The root object, in which arrays may still be records."""
    if path.stat().st_size > 2 * LARGEST:
        raise Refused(f"{path.stat().st_size:,} bytes")
    with path.open("rb") as file:
        zipped = file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")  # the second: an empty one
    if zipped:
        entries = Budget()  # apart from what is made of them
        with zipfile.ZipFile(path) as file:
            if any(name.rsplit("/")[-1] == "data.pkl" for name in file.namelist()):
                return read_zip(file, lambda name: read_entry(file, name, entries))
            return {name: _npy(data) for name, data in arrays_in(file, entries)}
    data = path.read_bytes()
    if data[:1] == b"\x78" or data[:2] == b"\x1f\x8b":
        data = _inflated(zlib.decompressobj(wbits=47), data, budget)
    elif data[:3] == b"BZh":
        data = _inflated(bz2.BZ2Decompressor(), data, budget)
    elif data[:6] == b"\xfd7zXZ\x00" or data[:3] == b"\x5d\x00\x00":
        data = _inflated(lzma.LZMADecompressor(memlimit=1 << 28), data, budget)
    if data[:6] == b"\x93NUMPY":
        return _npy(data)
    if _ROW_OF_PICKLES in data[:32]:
        return read_row_of_pickles(data)
    return Machine(Stream(data), TENSORS).load_raw()


def _inflated(decompressor: Any, data: bytes, budget: Budget) -> bytes:  # noqa: ANN401
    """Everything that was compressed, as long as the budget lasts."""
    whole = bytearray()
    while not decompressor.eof:
        part = decompressor.decompress(data, 1 << 24)
        data = getattr(decompressor, "unconsumed_tail", b"")
        if not part and not data:
            raise Damaged("the compressed data end too early")
        budget.spend(len(part))
        whole += part
    return whole


def _npy(data: bytes) -> Any:  # noqa: ANN401
    """A .npy's array, or the pickle behind its header where it holds objects."""
    file = io.BytesIO(data)
    header = read_header(file)
    if header.dtype.hasobject:
        return Machine(Stream(data[file.tell() :]), TENSORS).load_raw()
    return bytes_to_array(data[file.tell() :], header.dtype, header.shape, header.order)
