"""torch's tensors, as arrays and without torch: their storages are bytes in the file.

There are two containers. The older one, which also lies inside plain pickles as one long string, is
a row of pickles with the storages behind them; the newer one is a zip with one file a storage. Both
name the device a storage came from, which is of no interest here: CUDA's are read as well.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from struct import unpack
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused
from gva_mi.core.pickles.machine import Machine, Stream
from gva_mi.core.pickles.meanings import Name, Record

_MAGIC = 0x1950A86A20F9469CFC6C  # the first pickle of the older container
_STORAGES = {
    "Float": "f4", "Double": "f8", "Half": "f2", "BFloat16": "u2", "Long": "i8", "Int": "i4",
    "Short": "i2", "Char": "i1", "Byte": "u1", "Bool": "?",
}  # fmt: skip


class Storage(Record):
    """A row of numbers that tensors look into."""

    def __init__(self, kind: str) -> None:
        self.kind, self.data = kind, b""

    def take(self, data: bytes) -> None:
        self.data = data

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.ndarray:
        row = np.frombuffer(self.data, _STORAGES[self.kind])
        if self.kind == "BFloat16":  # the upper half of a float32
            return (row.astype(np.uint32) << 16).view(np.float32)
        return row


class Tensor(Record):
    """A view of a storage."""

    def __init__(self, storage: Storage, offset: int, size: tuple, stride: tuple) -> None:
        if not isinstance(storage, Storage):
            raise Damaged("a tensor without a storage")
        self.storage, self.offset = storage, int(offset)
        self.size, self.stride = (tuple(int(n) for n in x) for x in (size, stride))
        if len(self.size) != len(self.stride) or min((*self.size, *self.stride, offset, 0)) < 0:
            raise Damaged(f"a tensor of size {self.size} with strides {self.stride}")

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.ndarray:
        row = resolve(self.storage)
        if 0 in self.size:
            return np.zeros(self.size, row.dtype)
        last = sum((n - 1) * step for n, step in zip(self.size, self.stride, strict=True))
        if self.offset + last >= len(row):
            raise Damaged(f"a tensor of size {self.size} in a storage of {len(row)} numbers")
        budget.spend(math.prod(self.size) * row.itemsize)  # it may repeat itself, as do others
        strides = [step * row.itemsize for step in self.stride]
        return np.lib.stride_tricks.as_strided(row[self.offset :], self.size, strides).copy()


def read_row_of_pickles(data: bytes) -> Any:  # noqa: ANN401
    """What the older container holds, tensors as records."""
    stream, found = Stream(data), {}
    if Machine(stream).load_raw() != _MAGIC:
        raise Damaged("torch's magic number is missing")
    for _ in ("protocol", "sizes of types"):
        Machine(stream).load_raw()

    def storage(pid: Any) -> Storage:  # noqa: ANN401
        kind, key = _kind(pid)
        return found.setdefault(key, Storage(kind))

    root = Machine(stream, TENSORS, storage).load_raw()
    for key in Machine(stream).load_raw():
        if key not in found:
            raise Damaged("a storage that no tensor looks into")
        count = unpack("<q", stream.read(8))[0]
        found[key].take(stream.read(count * np.dtype(_STORAGES[found[key].kind]).itemsize))
    return root


def read_zip(file: zipfile.ZipFile, read: Callable[[str], bytes]) -> Any:  # noqa: ANN401
    """What the newer container holds, tensors as records; ``read`` gives an entry's bytes."""
    pickled = next(name for name in file.namelist() if name.rsplit("/")[-1] == "data.pkl")
    folder = pickled[: -len("data.pkl")]
    if f"{folder}byteorder" in file.namelist() and read(f"{folder}byteorder") != b"little":
        raise Refused("tensors in big-endian order")
    found: dict[str, Storage] = {}

    def storage(pid: Any) -> Storage:  # noqa: ANN401
        kind, key = _kind(pid)
        if key not in found:
            found[key] = Storage(kind)
            found[key].take(read(f"{folder}data/{key}"))
        return found[key]

    return Machine(Stream(read(pickled)), TENSORS, storage).load_raw()


def _kind(pid: Any) -> tuple[str, str]:  # noqa: ANN401
    """Type and key of a storage, from ``("storage", type, key, device, count, ...)``."""
    if not isinstance(pid, tuple) or len(pid) < 5 or pid[0] != "storage":
        raise Damaged("a reference that is no storage")
    name, key = pid[1], pid[2]
    kind = name.text[len("torch.") : -len("Storage")] if isinstance(name, Name) else ""
    if kind not in _STORAGES or not isinstance(key, str):
        raise Refused(f"a storage of {getattr(name, 'text', name)!s:.60}")
    return kind, key


def _tensor(storage: Storage, offset: int, size: tuple, stride: tuple, *_: object) -> Tensor:
    return Tensor(storage, offset, size, stride)


def _parameter(tensor: Tensor, *_: object) -> Tensor:
    return tensor


TENSORS: dict[str, Callable[..., Any] | None] = {
    "torch._utils._rebuild_tensor": _tensor, "torch._utils._rebuild_tensor_v2": _tensor,
    "torch._utils._rebuild_parameter": _parameter,
    "torch.storage._load_from_bytes": read_row_of_pickles,
    "torch.Size": lambda size=(): tuple(size),
    "torch.device": lambda *name: ":".join(map(str, name)),
    **{f"torch.{kind}Storage": None for kind in _STORAGES},
}  # fmt: skip
