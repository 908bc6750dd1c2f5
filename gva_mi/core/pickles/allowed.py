"""Allow-list of the names in a pickle, each with a constructor or None (a name without a value)."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused, bytes_to_array, require_bytes
from gva_mi.core.pickles.unpickler import Call, Shell, Unpickler

_PLAIN_DTYPE = re.compile(r"[?biufc]\d{0,2}|[SU]\d{0,6}|O8?")


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


# Arrays, and classes of arrays whose pickles hold no more than an array's.
_ARRAYS = (
    "numpy.ndarray", "numpy.memmap", "numpy.core.memmap.memmap", "numpy._core.memmap.memmap",
    "numpy.matrix", "numpy.matrixlib.defmatrix.matrix", "trimesh.caching.TrackedArray",
)  # fmt: skip


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

    unpickler: Unpickler

    def __setstate__(self, state: dict) -> None:
        dtype, stream = _read_dtype(state["dtype"]), self.unpickler.stream
        if dtype.hasobject:
            self.state = Unpickler(stream, self.unpickler.allowed).load()
            return
        if state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        data = stream.read(math.prod(state["shape"]) * dtype.itemsize)
        self.state = _frombuffer(data, state["dtype"], state["shape"], state.get("order"))

    def value(self, budget: Budget, state: np.ndarray) -> np.ndarray:
        return state


class Csr(Shell):
    """A sparse matrix of scipy, stored row by row, which becomes a dense array."""

    def value(self, budget: Budget, state: dict, *_: object) -> np.ndarray:
        data, counts, indices = state["data"], np.diff(state["indptr"]), state["indices"]
        if ((counts < 0) | (counts > len(data))).any() or counts.sum() != len(data):
            raise Damaged("a sparse matrix whose rows claim other numbers than there are")
        budget.spend(data.itemsize * math.prod(state["_shape"]))
        dense = np.zeros(state["_shape"], data.dtype)
        rows = np.repeat(np.arange(len(counts)), counts)
        np.add.at(dense.T if isinstance(self, Csc) else dense, (rows, indices), data)
        return dense


class Csc(Csr):
    """A sparse matrix that is stored column by column."""


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

    def value(self, budget: Budget, state: Any, *_: object) -> Any:  # noqa: ANN401
        return state


def _new(kind: type[Shell], base: Call, _: object = None) -> Shell:
    """Return an empty object, as ``copyreg._reconstructor`` does for protocols 0 and 1."""
    if not isinstance(kind, type) or base.text != "builtins.object":
        raise Refused(f"an instance of {getattr(kind, 'text', kind)!s:.60}")
    return kind()


def _encode(text: str, codec: str = "latin1") -> bytes:
    if codec not in ("latin1", "latin-1"):
        raise Refused(f"_codecs.encode to {codec!s:.40}")
    return text.encode("latin-1")


ALLOWED: dict[str, Any] = {
    **{f"builtins.{name}": None
       for name in ("object", "int", "float", "list", "dict", "long", "str", "bool")},
    "builtins.set": lambda items=(): set(items), "builtins.bytes": lambda: b"",
    "builtins.complex": complex,
    "collections.OrderedDict": lambda pairs=(): dict(pairs),
    "collections.defaultdict": lambda *_: {},  # a missing key stays missing
    "_codecs.encode": _encode, "copyreg._reconstructor": _new,
    **dict.fromkeys(_ARRAYS, ArrayClass), "numpy.dtype": Dtype,
    **{f"numpy.{core}.{name}": made for core in ("core", "_core") for name, made in (
        ("multiarray._reconstruct", _reconstruct), ("multiarray.scalar", _scalar),
        ("numeric._frombuffer", _frombuffer))},
    "joblib.numpy_pickle.NumpyArrayWrapper": JoblibArray,
    "scipy.sparse.csc.csc_matrix": Csc, "scipy.sparse._csc.csc_matrix": Csc,
    "scipy.sparse.csr.csr_matrix": Csr, "scipy.sparse._csr.csr_matrix": Csr,
    "typing.Any": None,
    **{f"omegaconf.{name}": Setting for name in (
        "base.Metadata", "base.ContainerMetadata", "dictconfig.DictConfig",
        "listconfig.ListConfig",
        *(f"nodes.{of}Node" for of in ("Any", "Boolean", "Float", "Integer", "String")))},
    "chumpy.ch.Ch": Chumpy, "chumpy.reordering.Select": Chumpy,
}  # fmt: skip
