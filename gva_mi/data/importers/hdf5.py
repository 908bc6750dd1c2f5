"""Read arrays of HDF5 files that may be hostile.

A name in such a file may link to another file; an array may lie in another file, be put together
from others, or claim any size. Such arrays are refused before anything of them is read.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.arrays import LARGEST
from gva_mi.core.errors import InputError, reason_of

SUFFIXES = (".hdf5", ".h5")
_FILTERS = (None, "lzf", "gzip", "szip")  # those that h5py brings
_LARGEST_CHUNK = 1 << 28  # bytes that one block may unfold to


def read_hdf5(path: Path, name: str) -> np.ndarray:
    """Read one array of numbers."""
    with _opened(path, name) as array:
        if array.size * array.dtype.itemsize > LARGEST:
            raise InputError(f"{path}: '{name}' {array.shape} is larger than {LARGEST >> 30} GiB")
        return array[()]


def rows_of_hdf5(path: Path, name: str) -> Iterator[np.ndarray]:
    """The rows of an array of three axes, one by one."""
    with _opened(path, name) as array:
        if array.ndim != 3:
            raise InputError(f"{path}: '{name}' must be (T, H, W), got {array.shape}")
        if array[:1].size * array.dtype.itemsize > _LARGEST_CHUNK:
            raise InputError(f"{path}: '{name}' {array.shape} has rows that are too large")
        for k in range(len(array)):
            yield array[k]


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Any]:
    """The array of a name in an open file; any error of the library becomes one sentence."""
    try:
        import h5py
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: needs the package h5py to be read; pip install 'gva_mi[hdf5]'"
        ) from None
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected arrays in HDF5")
    try:
        with h5py.File(path, "r") as file:
            yield _array(path, file, name)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: damaged, or no HDF5 file ({reason_of(error):.80})") from None


def _array(path: Path, file: Any, name: str) -> Any:  # noqa: ANN401
    """The dataset of a name, if it is an array of numbers that lies in this very file."""
    import h5py

    if name not in file.keys():
        names = ", ".join(sorted(file.keys())[:12]) or "nothing"
        raise InputError(f"{path}: has no array '{name}'; found: {names}")
    here = isinstance(file.get(name, getlink=True), h5py.HardLink)
    array = file[name] if here else None
    if here and (not isinstance(array, h5py.Dataset) or array.dtype.kind not in "biuf"):
        raise InputError(f"{path}: '{name}' must be an array of numbers")
    if not here or array.is_virtual or array.external:
        raise InputError(f"{path}: '{name}' is a link, or lies in other files: these are not read")
    if array.compression not in _FILTERS:
        raise InputError(f"{path}: '{name}' is packed by a filter that is not known")
    block = np.prod(array.chunks or (0,), dtype=np.float64) * array.dtype.itemsize
    if block > _LARGEST_CHUNK:
        raise InputError(f"{path}: '{name}' claims blocks of {block:,.0f} bytes")
    return array
