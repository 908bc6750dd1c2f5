"""The allow-list: names in pickles of numpy, joblib, torch, scipy and others, and their values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from io import BytesIO
from struct import unpack
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused, bytes_to_array, require_bytes
from gva_mi.core.pickles.unpickler import Call, Shell, Unpickler

_PLAIN_DTYPE = re.compile(r"[?biufc]\d{0,2}|[SU]\d{0,6}|O8?")
# Arrays, and classes of arrays whose pickles hold no more than an array's.
_ARRAYS = (
    "numpy.ndarray", "numpy.memmap", "numpy.core.memmap.memmap", "numpy._core.memmap.memmap",
    "numpy.matrix", "numpy.matrixlib.defmatrix.matrix", "trimesh.caching.TrackedArray",
)  # fmt: skip
_STORAGES = {  # of torch: their numbers
    "Float": "f4", "Double": "f8", "Half": "f2", "BFloat16": "u2", "Long": "i8", "Int": "i4",
    "Short": "i2", "Char": "i1", "Byte": "u1", "Bool": "?",
}  # fmt: skip


def load(stream: BytesIO, outside: Callable[[Any], Any] | None = None) -> Any:  # noqa: ANN401
    """Read one pickle; arrays in it are shells still."""
    return Unpickler(stream, ALLOWED, outside).load()


class Dtype(Shell):
    """``numpy.dtype`` of numbers, Booleans, text or objects, in either byte order."""

    def value(self, budget: Budget | None, state: tuple | None, code: str, *_: object) -> np.dtype:
        order, subdtype, names = state[1:4] if state else ("=", None, None)
        if not isinstance(code, str) or not _PLAIN_DTYPE.fullmatch(code):
            raise Refused(f"an array of dtype {code!r:.40}")
        if subdtype is not None or names is not None:
            raise Refused("a structured array")
        return np.dtype(code).newbyteorder(order if order in ("<", ">") else "=")


def _read_dtype(shell: Shell) -> np.dtype:
    """Return the dtype of a shell while the file is still being read."""
    if not isinstance(shell, Dtype):
        raise Damaged("an array without a dtype")
    return shell.value(None, shell.state, *shell.args)


class Array(Shell):
    """``numpy.ndarray``: its state holds its bytes, or the list of its objects."""

    def value(self, budget: Budget, state: tuple, *_: object) -> np.ndarray:
        return _array(budget, *state[1:])


def _array(
    budget: Budget, shape: tuple, dtype: np.dtype, fortran: bool, data: bytes | str | list
) -> np.ndarray:
    order = "F" if fortran else "C"
    if isinstance(data, list) != dtype.hasobject:
        raise Damaged("an array's contents do not fit its dtype")
    if not isinstance(data, list):
        budget.spend(len(data))  # because many arrays may share their bytes
        data = data.encode("latin-1") if isinstance(data, str) else data  # written by Python 2
        return bytes_to_array(data, dtype, shape, order)
    require_bytes(shape, 1, len(data))
    flat = np.empty(len(data), object)
    for k, item in enumerate(data):
        flat[k] = item
    return flat.reshape(shape, order=order)


class ArrayClass(Shell):
    """A class of arrays, which is only named."""

    def __new__(cls, *_: object) -> ArrayClass:
        raise Refused(f"a call of {cls.text}")


def _reconstruct(kind: type, *_: object) -> Array:
    if not isinstance(kind, type) or not issubclass(kind, ArrayClass):
        raise Refused(f"an array of class {getattr(kind, '__name__', kind)!s:.60}")
    return Array()


def _frombuffer(data: bytes, dtype: Dtype, shape: tuple, order: str) -> Array:
    array = Array()
    array.state = (None, shape, dtype, order == "F", data)
    return array


def _scalar(dtype: Dtype, data: bytes | str) -> np.generic:
    if _read_dtype(dtype).hasobject:
        raise Refused("numpy.core.multiarray.scalar of an object")
    return _array(Budget(), (1,), _read_dtype(dtype), False, data)[0]


class JoblibArray(Shell):
    """``NumpyArrayWrapper`` of joblib: the bytes of the array follow in the file."""

    def __setstate__(self, state: dict) -> None:
        dtype, stream = _read_dtype(state["dtype"]), self.unpickler.stream
        if dtype.hasobject:
            self.state = load(stream)
            return
        if state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        data = stream.read(math.prod(state["shape"]) * dtype.itemsize)
        self.state = _frombuffer(data, state["dtype"], state["shape"], state.get("order"))


class Sparse(Shell):
    """A sparse matrix of scipy, stored by rows or columns, which becomes a dense array."""

    def value(self, budget: Budget, state: dict, *_: object) -> np.ndarray:
        data, counts, indices = state["data"], np.diff(state["indptr"]), state["indices"]
        if ((counts < 0) | (counts > len(data))).any() or counts.sum() != len(data):
            raise Damaged("a sparse matrix whose rows claim other numbers than there are")
        budget.spend(data.itemsize * math.prod(state["_shape"]))
        dense = np.zeros(state["_shape"], data.dtype)
        rows = np.repeat(np.arange(len(counts)), counts)
        np.add.at(dense.T if "csc" in self.text else dense, (rows, indices), data)
        return dense


class Chumpy(Shell):
    """An array of chumpy, which old SMPL files hold, or a selection of one's elements."""

    def value(self, budget: Budget, state: dict, *_: object) -> np.ndarray:
        if "x" in state:
            return state["x"]
        whole, places = state["a"], state["idxs"]
        budget.spend((whole.size + places.size) * whole.itemsize)  # others may share them
        return whole.ravel()[places].reshape(state.get("preferred_shape") or places.shape)


class Setting(Shell):
    """A node of OmegaConf's settings, which becomes its plain value, without its types."""

    def __setstate__(self, state: dict) -> None:
        self.state = state.get("_content", state.get("_val"))


class Storage(Shell):
    """Memory of torch's numbers, of which tensors are views; those of a GPU are read as well."""

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


def storage_of(found: dict[str, Storage], pid: tuple) -> Storage:
    """Return the storage of ``("storage", type, key, device, count, ...)``, kept in ``found``."""
    _, name, key, *_ = pid
    kind = name.text[len("torch.") : -len("Storage")] if isinstance(name, Call) else ""
    if kind not in _STORAGES or not isinstance(key, str):
        raise Refused(f"a storage of {getattr(name, 'text', name)!s:.60}")
    return found.setdefault(key, Storage(kind))


def load_row_of_pickles(data: bytes) -> Any:  # noqa: ANN401
    """Read torch's older container: a row of pickles, with the storages behind them."""
    stream, found = BytesIO(data), {}
    each = (load(stream, lambda pid: storage_of(found, pid)) for _ in range(5))
    _magic, _protocol, _sizes, root, keys = each
    for key in keys:
        count = unpack("<q", stream.read(8))[0]
        itemsize = np.dtype(_STORAGES[found[key].args[0]]).itemsize
        found[key].state = stream.read(count * itemsize)
    return root


def _new(kind: type[Shell], base: Call, _: object = None) -> Shell:
    """Return an empty object, as ``copyreg._reconstructor`` does for protocols 0 and 1."""
    if not isinstance(kind, type) or base.text != "builtins.object":
        raise Refused(f"an instance of {getattr(kind, 'text', kind)!s:.60}")
    return kind()


def _encode(text: str, codec: str = "latin1") -> bytes:
    if codec not in ("latin1", "latin-1"):
        raise Refused(f"_codecs.encode to {codec!s:.40}")
    return text.encode("latin-1")


ALLOWED: dict[str, Any] = {  # None: it can only be named
    **{f"builtins.{name}": None
       for name in ("object", "int", "float", "list", "dict", "long", "str", "bool")},
    "builtins.set": lambda items=(): set(items), "builtins.bytes": lambda: b"",
    "builtins.complex": complex, "typing.Any": None,
    "collections.OrderedDict": lambda pairs=(): dict(pairs),
    "collections.defaultdict": lambda *_: {},  # a missing key stays missing
    "_codecs.encode": _encode, "copyreg._reconstructor": _new,
    **dict.fromkeys(_ARRAYS, ArrayClass), "numpy.dtype": Dtype,
    **{f"numpy.{core}.{name}": made for core in ("core", "_core") for name, made in (
        ("multiarray._reconstruct", _reconstruct), ("multiarray.scalar", _scalar),
        ("numeric._frombuffer", _frombuffer))},
    "joblib.numpy_pickle.NumpyArrayWrapper": JoblibArray,
    **{f"scipy.sparse.{module}{kind}.{kind}_matrix": Sparse
       for kind in ("csc", "csr") for module in ("", "_")},
    **{f"omegaconf.{name}": Setting for name in (
        "base.Metadata", "base.ContainerMetadata", "dictconfig.DictConfig",
        "listconfig.ListConfig",
        *(f"nodes.{of}Node" for of in ("Any", "Boolean", "Float", "Integer", "String")))},
    "chumpy.ch.Ch": Chumpy, "chumpy.reordering.Select": Chumpy,
    "torch._utils._rebuild_tensor": Tensor, "torch._utils._rebuild_tensor_v2": Tensor,
    "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
    "torch.storage._load_from_bytes": load_row_of_pickles,
    "torch.Size": lambda size=(): tuple(size), "torch.device": lambda *name: str(name),
    **{f"torch.{kind}Storage": None for kind in _STORAGES},
}  # fmt: skip
