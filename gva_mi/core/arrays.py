"""Read ``.npy`` and ``.npz`` data without allocating more memory than the file accounts for.

A header may claim any size, a zip entry may unfold to a thousand times its own, and many entries
may share their bytes. So sizes are compared before anything is allocated, and all bytes made of
one file are counted against a :class:`Budget`.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, BinaryIO

import numpy as np

from gva_mi.core.errors import reason_of

Form = tuple[int | None, ...]  # of an array: the length of each axis, None for any
LARGEST = 4 << 30  # bytes that one file may unfold to
_DENSEST = 1100  # deflate packs at most 1032 bytes into one


def shape_fault(shape: Sequence[int], *forms: Form) -> str | None:
    """Say that a shape has none of some forms; None if it has one, or where none are given."""
    fits = lambda form: (
        len(form) == len(shape)
        and all(want in (None, got) for want, got in zip(form, shape, strict=True))
    )
    if not forms or any(map(fits, forms)):
        return None
    said = lambda form: str(tuple("*" if n is None else n for n in form)).replace("'", "")
    return f"must be {' or '.join(map(said, forms))}, got {tuple(shape)}"


class Refused(Exception):  # noqa: N818 (a verdict, which the reader turns into an InputError)
    """A file holds something that is not allowed; the message says what."""


class Damaged(Exception):  # noqa: N818
    """A file contradicts itself or ends too early; the message says how."""


class Budget:
    """Bytes that may still be made of one file."""

    def __init__(self, size: int = LARGEST) -> None:
        self.left = size

    def spend(self, size: int) -> None:
        """Take ``size`` bytes before they are allocated; raise Refused if too few are left."""
        if size > self.left:
            raise Refused(f"contents that unfold to more than {LARGEST >> 30} GiB")
        self.left -= size


def read_header(file: BinaryIO) -> tuple[np.dtype, tuple[int, ...], str]:
    """Return dtype, shape and order ("C" or "F") of a ``.npy``'s array.

    Raises:
        Refused, ValueError: it has no header that is known.
    """
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)  # fmt: skip
    if read is None:
        raise Refused(f"a .npy of version {version}")
    shape, fortran, dtype = read(file)
    return dtype, shape, "F" if fortran else "C"


def read_npy(data: bytes, unpickle: Callable[[bytes], Any] | None = None) -> Any:  # noqa: ANN401
    """Return the array of a whole ``.npy``, or what ``unpickle`` makes of the objects in it.

    Raises:
        Refused, Damaged, ValueError: it is none.
    """
    file = io.BytesIO(data)
    dtype, *form = read_header(file)
    if not dtype.hasobject:
        return bytes_to_array(memoryview(data)[file.tell() :], dtype, *form)
    if unpickle is None:
        raise Refused("pickled objects")
    return unpickle(data[file.tell() :])


def read_entry(file: zipfile.ZipFile, name: str, budget: Budget) -> bytes:
    """Return the bytes of one zip entry; raise Damaged if its stated size is wrong."""
    info = file.getinfo(name)
    if info.file_size > _DENSEST * (info.compress_size + 1):
        raise Damaged(f"'{name}' claims {info.file_size:,} bytes")
    budget.spend(info.file_size)
    try:
        with file.open(info) as entry:
            data = entry.read(info.file_size + 1)
    except Exception as error:  # zipfile and zlib each raise their own
        raise Damaged(f"'{name}': {reason_of(error)}") from None
    if len(data) != info.file_size:
        raise Damaged(f"'{name}' claims {info.file_size:,} bytes, but holds {len(data):,}")
    return data


def arrays_in(
    file: zipfile.ZipFile, budget: Budget, only: Collection[str] | None = None
) -> Iterator[tuple[str, bytes]]:
    """Yield name and ``.npy`` content of the arrays in an ``.npz``, or of ``only`` some of them."""
    names = [name.removesuffix(".npy") for name in file.namelist() if name.endswith(".npy")]
    if not names and any(name.rsplit("/")[-1] == "data.pkl" for name in file.namelist()):
        raise Refused("a file of torch; gsplat's export_splats writes its splats as .ply")
    if not names:
        raise Damaged("a zip without arrays")
    for name in names:
        if only is None or name in only:
            yield name, read_entry(file, f"{name}.npy", budget)


def bytes_to_array(
    data: bytes | memoryview, dtype: np.dtype, shape: tuple[int, ...], order: str = "C"
) -> np.ndarray:
    """Copy bytes into a writable array; raise Damaged if shape and bytes disagree."""
    require_bytes(shape, dtype.itemsize, len(data))
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy(order=order)


def require_bytes(shape: tuple[int, ...], itemsize: int, found: int) -> None:
    """Raise Damaged if a shape claims another number of bytes than there are."""
    claimed = math.prod(shape) * itemsize
    if itemsize == 0 and math.prod(shape) > found + 1024:
        raise Damaged(f"an array claims {math.prod(shape):,} items of no size")
    if claimed != found:
        raise Damaged(f"an array claims {claimed:,} bytes, but holds {found:,}")
