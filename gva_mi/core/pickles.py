"""Read the arrays and plain values of other people's files without running any code of theirs.

A pickle names functions, which Python would import and call. Here a name only selects an entry of
:data:`ALLOWED`, or is refused, and only arrays and :class:`_Object` accept a state. Torch's files
are read by torch, with ``weights_only``.

Formats: pickles of every protocol, also Python 2's, and files of ``joblib.dump``, both also
compressed by zlib or gzip; ``.npy`` and ``.npz`` with objects; torch's files.
"""

from __future__ import annotations

import math
import pickle
import re
import zipfile
import zlib
from collections import OrderedDict
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import known_container, reason_of_read, require_file

_PLAIN_DTYPE = re.compile(r"[?biufc]\d{0,2}|[SU]\d{0,6}|O8?")
_OLD_TORCH = b"\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."  # its magic number, pickled


class Refused(Exception):  # noqa: N818 (a verdict, which becomes an InputError)
    """A file holds something that is not read; the message names it."""


def read_objects(path: Path, expected: str) -> Any:  # noqa: ANN401
    """Read a file's dictionaries, lists, text, numbers and arrays.

    Tensors, sparse matrices and chumpy's arrays become plain arrays. No code of the file runs.
    ``expected`` says in the error what the file should hold.
    """
    path = Path(path)
    require_file(path, expected)
    try:
        return _load(path)
    except Refused as error:
        fault = f"holds {error}, which is not read because it may run code or is no plain array"
    except Exception as error:  # a damaged file can fail in any opcode, and in any way
        fault = f"damaged, cut short, or of an unknown kind ({reason_of_read(error)})"
        fault = known_container(path) or fault
    raise InputError(f"{path}: {fault}; expected {expected}")


def _load(path: Path) -> Any:  # noqa: ANN401
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as file:
            names = file.namelist()
            if any(Path(name).name == "data.pkl" for name in names):
                return _load_torch(path)
            arrays = [x for x in names if x.endswith(".npy") and Path(x).name[0] != "."]
            load = lambda name: _load_npy(BytesIO(file.read(name)))
            return {name.removesuffix(".npy"): load(name) for name in arrays}
    data = path.read_bytes()
    if _OLD_TORCH in data[:32]:
        return _load_torch(path)
    if data[:1] == b"\x78" or data[:2] == b"\x1f\x8b":
        data = zlib.decompress(data, wbits=47)
    return (_load_npy if data[:6] == b"\x93NUMPY" else load_pickle)(BytesIO(data))


def _load_npy(file: BinaryIO) -> Any:  # noqa: ANN401
    try:
        return np.lib.format.read_array(file, allow_pickle=False)
    except ValueError:  # an array of objects, whose pickle follows the header
        return load_pickle(file)


def _load_torch(path: Path) -> Any:  # noqa: ANN401
    import torch

    def plain(x: Any) -> Any:  # noqa: ANN401
        if isinstance(x, dict):
            return {key: plain(value) for key, value in x.items()}
        if isinstance(x, list | tuple):
            return type(x)(map(plain, x))
        if not isinstance(x, torch.Tensor):
            return x
        return (x.float() if x.dtype == torch.bfloat16 else x).detach().numpy()

    try:
        return plain(torch.load(path, map_location="cpu", weights_only=True))
    except pickle.UnpicklingError:  # with a page of advice
        raise Refused("objects that are no tensors") from None


def load_pickle(file: BinaryIO) -> Any:  # noqa: ANN401
    """Read one pickle from a stream by :data:`ALLOWED`."""
    return _Unpickler(file).load()


class _Unpickler(pickle._Unpickler):
    """Python's unpickler written in Python: the one in C allocates as much as a file claims."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="latin1")  # for text of Python 2
        self.file = file

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401
        package = {"__builtin__": "builtins", "copy_reg": "copyreg"}.get(module, module)
        package = package.partition(".")[0]
        found = _Setting if package == "omegaconf" else ALLOWED.get((package, name))
        if found is None:
            raise Refused(f"{module}.{name}")
        return found

    def _set_state(self) -> None:
        state, target = self.stack.pop(), self.stack[-1]
        if type(target) is np.ndarray:
            _fill(target, *state)
        elif isinstance(target, np.dtype):
            if state[1] == ">":
                raise Refused("big-endian numbers")
        elif isinstance(target, _Object):
            self.stack[-1] = value = target.value(state, self.file)
            for key, remembered in self.memo.items():
                if remembered is target:
                    self.memo[key] = value
        else:
            raise Refused(f"a state for {target!r:.60}")

    dispatch = pickle._Unpickler.dispatch | {pickle.BUILD[0]: _set_state}


def _fill(array: np.ndarray, version: int, shape: tuple, *rest: Any) -> None:  # noqa: ANN401
    if min(shape, default=0) < 0:
        raise ValueError(f"an array of shape {shape}")
    array.__setstate__((version, shape, *rest))  # which checks the number of bytes


class _Object:
    """An object of a file, which is replaced by a value as soon as its state is known."""

    def __new__(cls, *_: object) -> _Object:
        return super().__new__(cls)

    def value(self, state: dict, file: BinaryIO) -> Any:  # noqa: ANN401
        raise NotImplementedError


class _Joblib(_Object):
    """``NumpyArrayWrapper`` of joblib: the bytes of the array follow in the file."""

    def value(self, state: dict, file: BinaryIO) -> np.ndarray:
        dtype, shape = state["dtype"], state["shape"]
        if dtype.hasobject:
            return load_pickle(file)
        if state.get("numpy_array_alignment_bytes") is not None:
            file.read(file.read(1)[0])
        data = file.read(math.prod(shape) * dtype.itemsize)
        return _array(data, dtype, shape, state["order"])


class _Csc(_Object):
    """A sparse matrix of scipy, stored by columns or rows, which becomes a dense array."""

    form = "csc_matrix"

    def value(self, state: dict, file: BinaryIO) -> np.ndarray:
        from scipy import sparse

        parts = state["data"], state["indices"], state["indptr"]
        found = getattr(sparse, self.form)(parts, state["_shape"])
        found.check_format(full_check=True)
        return found.toarray()


class _Csr(_Csc):
    form = "csr_matrix"


class _Chumpy(_Object):
    """An array of chumpy, which old SMPL files hold, or a selection of its elements."""

    def value(self, state: dict, file: BinaryIO) -> np.ndarray:
        if "x" in state:
            return state["x"]
        places = state["idxs"]
        return state["a"].ravel()[places].reshape(state.get("preferred_shape") or places.shape)


class _Setting(_Object):
    """A node of OmegaConf's settings in MoSh's files, which becomes its plain value."""

    def value(self, state: dict, file: BinaryIO) -> Any:  # noqa: ANN401
        return state.get("_content", state.get("_val"))


def _dtype(code: str, *_: object) -> np.dtype:
    if not _PLAIN_DTYPE.fullmatch(code):
        raise Refused(f"an array of dtype {code!r:.40}")
    return np.dtype(code)


def _array(data: bytes | str, dtype: np.dtype, shape: tuple = (1,), order: str = "C") -> np.ndarray:
    data = data.encode("latin-1") if isinstance(data, str) else data  # written by Python 2
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy(order)


def _reconstructed(kind: type, *_: object) -> _Object:
    """Return an empty object, as ``copyreg._reconstructor`` does for protocols 0 and 1."""
    if not issubclass(kind, _Object):
        raise Refused(f"an instance of {kind!r:.60}")
    return kind()


def _encode(text: str, codec: str) -> bytes:
    if codec not in ("latin1", "latin-1"):
        raise Refused(f"_codecs.encode to {codec!s:.40}")
    return text.encode("latin-1")


# By package and name, whatever module lies between. A text stands for a class that is never used.
ALLOWED: dict[tuple[str, str], Any] = {
    **{("builtins", kind.__name__): kind
       for kind in (object, bool, int, float, complex, str, list, dict, set)},
    ("builtins", "bytes"): lambda: b"", ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): lambda *_: {},  # a missing key stays missing
    ("copyreg", "_reconstructor"): _reconstructed, ("typing", "Any"): "typing.Any",
    ("numpy", "dtype"): _dtype, ("numpy", "_frombuffer"): _array,
    ("numpy", "scalar"): lambda dtype, data: _array(data, dtype)[0],
    ("numpy", "_reconstruct"): lambda *_: np.zeros(0, "u1"),
    **{("numpy", name): f"numpy.{name}" for name in ("ndarray", "memmap")},
    ("trimesh", "TrackedArray"): "trimesh.TrackedArray",
    ("joblib", "NumpyArrayWrapper"): _Joblib,
    ("scipy", "csc_matrix"): _Csc, ("scipy", "csr_matrix"): _Csr,
    ("chumpy", "Ch"): _Chumpy, ("chumpy", "Select"): _Chumpy,
}  # fmt: skip
