"""Arrays in ``.npy`` and ``.npz``: no file makes more memory than it holds bytes for.

A header may claim any size, a zip's entry may unfold to a thousand times its own, and many entries
may share their bytes. So sizes are compared before anything is allocated, and the bytes of one file
are counted against a :class:`~gva_mi.budget.Budget`.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Collection, Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from gva_mi.budget import Budget, Damaged, Refused
from gva_mi.errors import reason_of

_DENSEST = 1100  # deflate packs no more than 1032 bytes into one


class Header(NamedTuple):
    """What a ``.npy`` says of its array, which follows."""

    shape: tuple[int, ...]
    order: str  # "C" or "F"
    dtype: np.dtype


def read_header(file: BinaryIO) -> Header:
    """Read a ``.npy`` up to its array.

    Raises:
        Refused: it is of a version that is not known.
        ValueError: it is no header.
    """
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)  # fmt: skip
    if read is None:
        raise Refused(f"a .npy of version {version}")
    shape, fortran, dtype = read(file)
    return Header(shape, "F" if fortran else "C", dtype)


def read_npy(data: bytes) -> np.ndarray:
    """The array of a whole ``.npy``; objects are refused.

    Raises:
        Refused, Damaged, ValueError: it is none, or claims other bytes than there are.
    """
    file = io.BytesIO(data)
    header = read_header(file)
    if header.dtype.hasobject:
        raise Refused("pickled objects")
    return bytes_to_array(memoryview(data)[file.tell() :], header.dtype, header.shape, header.order)


def read_entry(file: zipfile.ZipFile, name: str, budget: Budget) -> bytes:
    """The bytes of one file in a zip.

    Raises:
        Damaged: it claims other bytes than it holds.
        Refused: the budget is spent.
    """
    info = file.getinfo(name)
    if info.file_size > _DENSEST * (info.compress_size + 1):
        raise Damaged(f"'{name}' claims {info.file_size:,} bytes")
    budget.spend(info.file_size)
    try:
        with file.open(info) as entry:
            data = entry.read(info.file_size + 1)
    except Exception as error:  # the zip and zlib each have their own
        raise Damaged(f"'{name}': {reason_of(error)}") from None
    if len(data) != info.file_size:
        raise Damaged(f"'{name}' claims {info.file_size:,} bytes, but holds {len(data):,}")
    return data


def arrays_in(
    file: zipfile.ZipFile, budget: Budget, only: Collection[str] | None = None
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the ``.npy`` in an ``.npz``, or of some of them.

    Raises:
        Damaged: there are none, or one claims other bytes than it holds.
        Refused: they unfold to too much.
    """
    names = [name.removesuffix(".npy") for name in file.namelist() if name.endswith(".npy")]
    if not names:
        raise Damaged("a zip without arrays")
    for name in names:
        if only is None or name in only:
            yield name, read_entry(file, f"{name}.npy", budget)


def bytes_to_array(
    data: bytes | memoryview, dtype: np.dtype, shape: tuple[int, ...], order: str = "C"
) -> np.ndarray:
    """A copy of bytes as an array that owns its memory and may be written to.

    Raises:
        Damaged: the shape claims more or fewer bytes than there are.
    """
    require_bytes(shape, dtype.itemsize, len(data))
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy(order=order)


def require_bytes(shape: tuple[int, ...], itemsize: int, found: int) -> None:
    """Raise Damaged where a shape claims other bytes than there are."""
    claimed = math.prod(shape) * itemsize
    if itemsize == 0 and math.prod(shape) > found + 1024:
        raise Damaged(f"an array claims {math.prod(shape):,} items of no size")
    if claimed != found:
        raise Damaged(f"an array claims {claimed:,} bytes, but holds {found:,}")
