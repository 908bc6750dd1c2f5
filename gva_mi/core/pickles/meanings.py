"""What the names in a pickle stand for. What is not in :data:`NAMES` is refused.

A name means a function of this file, which makes a plain value, or a *record*: what a pickle makes
first and fills afterwards. A record becomes an array when the whole file has been read.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused, bytes_to_array, require_bytes

_PLAIN_DTYPE = re.compile(r"[?biufc]\d{0,2}|[SU]\d{0,6}|O8?")


@dataclass(frozen=True)
class Name:
    """A name that a pickle uses, and what calling it makes here; None where it is only named."""

    text: str
    call: Callable[..., Any] | None = None


class Record(ABC):
    """What a pickle makes first and fills afterwards."""

    def fill(self, state: Any) -> None:  # noqa: ANN401
        """Take the state that the file gives."""
        raise Damaged("a state is given to what has none")

    @abstractmethod
    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> Any:  # noqa: ANN401
        """What it stands for, once all is read; ``resolve`` does the same for what is inside."""


class Dtype(Record):
    """numpy's ``dtype``: numbers, Booleans, text and objects, in either byte order."""

    def __init__(self, code: str, *_: object) -> None:
        if not isinstance(code, str) or not _PLAIN_DTYPE.fullmatch(code):
            raise Refused(f"an array of dtype {code!r:.40}")
        self.code, self.order = code, "="

    def fill(self, state: Any) -> None:  # noqa: ANN401
        order, subdtype, names = state[1:4]
        if subdtype is not None or names is not None:
            raise Refused("a structured array")
        self.order = order if order in ("<", ">") else "="

    @property
    def numpy(self) -> np.dtype:
        return np.dtype(self.code).newbyteorder(self.order)

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.dtype:
        return self.numpy


class Array(Record):
    """numpy's ``ndarray``: its bytes, or the list of its objects."""

    def __init__(self) -> None:
        self.shape: tuple[int, ...] = (0,)
        self.dtype = np.dtype(np.float64)
        self.fortran, self.data = False, b""

    def fill(self, state: Any) -> None:  # noqa: ANN401
        _, shape, dtype, fortran, data = state
        self.take(shape, dtype, fortran, data)

    def take(self, shape: tuple, dtype: Dtype, fortran: bool, data: bytes | list) -> None:
        """Keep what was read, if there are as many bytes or objects as the shape claims."""
        self.shape, self.dtype = _shape(shape), dtype.numpy
        self.fortran = bool(fortran)
        if isinstance(data, str):  # of Python 2
            data = data.encode("latin-1")
        if isinstance(data, list) != self.dtype.hasobject:
            raise Damaged("an array's contents do not fit its dtype")
        require_bytes(self.shape, 1 if isinstance(data, list) else self.dtype.itemsize, len(data))
        self.data = data

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.ndarray:
        order = "F" if self.fortran else "C"
        if not isinstance(self.data, list):
            budget.spend(len(self.data))  # for many arrays may share their bytes
            return bytes_to_array(self.data, self.dtype, self.shape, order)
        flat = np.empty(len(self.data), object)
        for k, item in enumerate(self.data):
            flat[k] = resolve(item)
        return flat.reshape(self.shape, order=order)


class Sparse(Record):
    """One of scipy's sparse matrices, which becomes a dense array."""

    def __init__(self, form: str) -> None:
        self.form, self.state = form, {}

    def fill(self, state: Any) -> None:  # noqa: ANN401
        self.state = state

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.ndarray:
        state = {key: resolve(x) for key, x in self.state.items()}
        shape = _shape(state.get("_shape", state.get("shape")))
        data = state["data"]
        if len(shape) != 2 or data.ndim != 1 or data.dtype.kind not in "biuf":
            raise Damaged("a sparse matrix without rows, columns and numbers")
        budget.spend(data.itemsize * math.prod(shape))
        if self.form == "coo":
            rows, columns = state["coords"] if "coords" in state else (state["row"], state["col"])
        else:
            counts = np.diff(state["indptr"])
            if ((counts < 0) | (counts > len(data))).any() or counts.sum() != len(data):
                raise Damaged("a sparse matrix whose rows claim other numbers than there are")
            rows, columns = np.repeat(np.arange(len(counts)), counts), state["indices"]
            if self.form == "csc":
                rows, columns = columns, rows
        dense = np.zeros(shape, data.dtype)
        np.add.at(dense, (rows, columns), data)
        return dense


class Chumpy(Record):
    """An array of the package chumpy, in which old SMPL files hold theirs; or some of one."""

    def __init__(self, form: str) -> None:
        self.form, self.state = form, {}

    def fill(self, state: Any) -> None:  # noqa: ANN401
        self.state = state

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> np.ndarray:
        if self.form == "Ch":
            return resolve(self.state["x"])
        whole, places = resolve(self.state["a"]), resolve(self.state["idxs"])
        budget.spend((whole.size + places.size) * whole.itemsize)  # others may share them
        chosen = whole.ravel()[places]
        shape = self.state.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(_shape(resolve(shape)))


def _shape(shape: Any) -> tuple[int, ...]:  # noqa: ANN401
    shape = tuple(int(n) for n in shape)
    if any(n < 0 for n in shape) or len(shape) > 32:
        raise Damaged(f"an array of shape {shape}")
    return shape


def _reconstruct(kind: Name, *_: object) -> Array:
    if not isinstance(kind, Name) or kind.text != "numpy.ndarray":
        raise Refused(f"an array of class {getattr(kind, 'text', kind)!s:.60}")
    return Array()


def _frombuffer(data: bytes, dtype: Dtype, shape: tuple, order: str) -> Array:
    array = Array()
    array.take(shape, dtype, order == "F", data)
    return array


def _scalar(dtype: Dtype, data: bytes | str) -> np.generic:
    if dtype.numpy.hasobject:
        raise Refused("numpy.core.multiarray.scalar of an object")
    data = data.encode("latin-1") if isinstance(data, str) else data
    return bytes_to_array(data, dtype.numpy, (1,))[0]


def _encode(text: str, codec: str = "latin1") -> bytes:
    if codec not in ("latin1", "latin-1"):
        raise Refused(f"_codecs.encode to {codec!s:.40}")
    return text.encode("latin-1")


def _new(kind: Name, base: Name, _: object = None) -> Any:  # noqa: ANN401
    """``copy_reg._reconstructor``: an instance of a class, empty."""
    if not isinstance(kind, Name) or kind.call is None or base.text != "builtins.object":
        raise Refused(f"an instance of {getattr(kind, 'text', kind)!s:.60}")
    return kind.call()


def _default_dict(factory: Name | None = None) -> dict:
    """``defaultdict`` as a plain dict: what is missing stays missing."""
    plain = ("builtins.list", "builtins.dict", "builtins.int", "builtins.float", "builtins.set")
    if factory is not None and getattr(factory, "text", "") not in plain:
        raise Refused(f"collections.defaultdict of {getattr(factory, 'text', factory)!s:.60}")
    return {}


def _ordered(*pairs: Any) -> OrderedDict:  # noqa: ANN401
    found = OrderedDict()
    for key, value in pairs[0] if pairs else ():
        if not isinstance(key, str | bytes | int | float):
            raise Refused("a key that is no text or number")
        found[key] = value
    return found


def _items(kind: type) -> Callable[..., Any]:
    """A builtin container made of a list."""

    def make(items: list | tuple = ()) -> Any:  # noqa: ANN401
        if any(isinstance(x, tuple | frozenset) for x in items) and kind is not tuple:
            raise Refused("a set of containers")
        return kind(items)

    return make


NAMES: dict[str, Callable[..., Any] | None] = {
    "builtins.object": None, "builtins.int": None, "builtins.float": None, "builtins.str": None,
    "builtins.bool": None, "builtins.list": None, "builtins.dict": None,
    "builtins.set": _items(set), "builtins.frozenset": _items(frozenset),
    "builtins.tuple": _items(tuple), "builtins.bytes": lambda: b"",
    "builtins.complex": lambda re, im: complex(float(re), float(im)),
    "collections.OrderedDict": _ordered, "collections.defaultdict": _default_dict,
    "_codecs.encode": _encode, "copyreg._reconstructor": _new,
    "numpy.ndarray": None, "numpy.dtype": Dtype,
    "numpy.core.multiarray._reconstruct": _reconstruct,
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _frombuffer,
    "chumpy.ch.Ch": lambda *_: Chumpy("Ch"),
    "chumpy.reordering.Select": lambda *_: Chumpy("Select"),
    **{
        f"scipy.sparse.{form}.{form}_{kind}": (lambda *_, form=form: Sparse(form))
        for form in ("csc", "csr", "coo")
        for kind in ("matrix", "array")
    },
}  # fmt: skip
_MODULES: Mapping[str, str] = {  # older and newer homes of the same names
    "__builtin__": "builtins", "copy_reg": "copyreg",
    "numpy._core.multiarray": "numpy.core.multiarray", "numpy._core.numeric": "numpy.core.numeric",
    **{f"scipy.sparse._{form}": f"scipy.sparse.{form}" for form in ("csc", "csr", "coo")},
}  # fmt: skip


def full_name(module: str, name: str) -> str:
    """A name under the one module that :data:`NAMES` knows it by."""
    return f"{_MODULES.get(module, module)}.{name}"
