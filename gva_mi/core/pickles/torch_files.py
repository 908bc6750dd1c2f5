"""Read torch's tensors as arrays, without torch.

The newer container is a zip with one file a storage. The older one, which also lies inside plain
pickles, is a row of pickles with the storages behind them. Tensors of a GPU are read as well.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from io import BytesIO
from struct import unpack
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused
from gva_mi.core.pickles.allowed import ALLOWED
from gva_mi.core.pickles.unpickler import Call, Shell, Unpickler, require_modest

_STORAGES = {
    "Float": "f4", "Double": "f8", "Half": "f2", "BFloat16": "u2", "Long": "i8", "Int": "i4",
    "Short": "i2", "Char": "i1", "Byte": "u1", "Bool": "?",
}  # fmt: skip


class Storage(Shell):
    """Memory of numbers, of which tensors are views."""

    def value(self, budget: Budget, state: bytes, kind: str) -> np.ndarray:
        row = np.frombuffer(state, _STORAGES[kind])
        if kind == "BFloat16":  # the upper half of a float32
            return (row.astype(np.uint32) << 16).view(np.float32)
        return row


class Tensor(Shell):
    """A view of a storage, which is copied."""

    def value(
        self, budget: Budget, _: None, row: np.ndarray, offset: int, size: tuple, stride: tuple,
        *more: object,
    ) -> np.ndarray:  # fmt: skip
        if len(size) != len(stride) or min((*size, *stride, offset)) < 0:
            raise Damaged(f"a tensor of size {size} with strides {stride}")
        last = sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if 0 not in size and offset + last >= len(row):
            raise Damaged(f"a tensor of size {size} in a storage of {len(row)} numbers")
        budget.spend(math.prod(size) * row.itemsize)  # because elements may be repeated
        strides = [step * row.itemsize for step in stride]
        return np.lib.stride_tricks.as_strided(row[offset:], size, strides).copy()


def read_row_of_pickles(data: bytes) -> Any:  # noqa: ANN401
    """Read the content of the older container, with tensors as shells."""
    stream, found = BytesIO(data), {}
    load = lambda: Unpickler(stream, WITH_TENSORS, lambda pid: _storage(found, pid)).load()
    _magic, _protocol, _sizes, root, keys = (load() for _ in range(5))
    for key in keys:
        count = unpack("<q", stream.read(8))[0]
        itemsize = np.dtype(_STORAGES[found[key].args[0]]).itemsize
        found[key].state = stream.read(count * itemsize)
    return root


def read_zip(file: zipfile.ZipFile, read: Callable[[str], bytes]) -> Any:  # noqa: ANN401
    """Read the content of the newer container, tensors as shells; ``read`` returns an entry."""
    pickled = next(name for name in file.namelist() if name.rsplit("/")[-1] == "data.pkl")
    folder = pickled[: -len("data.pkl")]
    if f"{folder}byteorder" in file.namelist() and read(f"{folder}byteorder") != b"little":
        raise Refused("tensors in big-endian order")
    found, data = {}, read(pickled)
    require_modest(data)
    root = Unpickler(BytesIO(data), WITH_TENSORS, lambda pid: _storage(found, pid)).load()
    for key, storage in found.items():
        storage.state = read(f"{folder}data/{key}")
    return root


def _storage(found: dict[str, Storage], pid: tuple) -> Storage:
    """Return the storage of ``("storage", type, key, device, count, ...)``."""
    _, name, key, *_ = pid
    kind = name.text[len("torch.") : -len("Storage")] if isinstance(name, Call) else ""
    if kind not in _STORAGES or not isinstance(key, str):
        raise Refused(f"a storage of {getattr(name, 'text', name)!s:.60}")
    return found.setdefault(key, Storage(kind))


WITH_TENSORS: dict[str, Any] = ALLOWED | {
    "torch._utils._rebuild_tensor": Tensor, "torch._utils._rebuild_tensor_v2": Tensor,
    "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
    "torch.storage._load_from_bytes": read_row_of_pickles,
    "torch.Size": lambda size=(): tuple(size), "torch.device": lambda *name: str(name),
    **{f"torch.{kind}Storage": None for kind in _STORAGES},
}  # fmt: skip
