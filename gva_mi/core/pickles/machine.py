"""The pickle machine, on which a file may name, call and fill nothing but what is on the list.

Python's own machine in Python is the base, for its opcodes can be replaced one by one. Replaced are
those that call (a name may be called only if the list gives it a meaning), those that set state
(only a :class:`Record` takes one), those that allocate by a claimed size, those that hash (keys are
text and numbers: the hash of nested tuples takes forever where they share parts), and those of
extension codes and out-of-band buffers, which files have no use for.

joblib's files are such programs too, with the bytes of each array right after the opcode that
fills its ``NumpyArrayWrapper``.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping
from struct import unpack
from typing import Any

import numpy as np

from gva_mi.core.arrays import Budget, Damaged, Refused
from gva_mi.core.pickles.meanings import NAMES, Array, Dtype, Name, Record, full_name

WRAPPER = "joblib.numpy_pickle.NumpyArrayWrapper"
Key = str | bytes | int | float | None | np.generic


class Stream:
    """Bytes that are read from the front; what is not there is never allocated."""

    def __init__(self, data: bytes | bytearray) -> None:
        self._data, self.at = data, 0

    def read(self, size: int) -> bytes:
        if not 0 <= size <= len(self._data) - self.at:
            left = len(self._data) - self.at
            raise Damaged(f"{size:,} bytes are claimed where {left:,} are left")
        self.at += size
        return bytes(self._data[self.at - size : self.at])

    def readline(self) -> bytes:
        end = self._data.find(b"\n", self.at)
        if end < 0:
            raise Damaged("a line without an end")
        return self.read(end + 1 - self.at)


class Wrapper(Record):
    """joblib's stand-in for an array whose bytes follow in the file."""

    def __init__(self) -> None:
        self.array: Any = None

    def fill(self, state: Any) -> None:  # noqa: ANN401
        self.state = state

    def read(self, stream: Stream) -> None:
        """Take the bytes, or the pickled objects, that follow."""
        dtype = self.state["dtype"]
        if not isinstance(dtype, Dtype):
            raise Damaged("an array without a dtype")
        if dtype.numpy.hasobject:
            self.array = Machine(stream).load_raw()
            return
        if self.state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        shape = tuple(int(n) for n in self.state["shape"])
        data = stream.read(math.prod(shape) * dtype.numpy.itemsize)
        self.array = Array()
        self.array.take(shape, dtype, self.state.get("order") == "F", data)

    def value(self, resolve: Callable[[Any], Any], budget: Budget) -> Any:  # noqa: ANN401
        return resolve(self.array)


class Machine(pickle._Unpickler):
    """Reads one pickle from a stream.

    Args:
        stream: stands at its first byte, and stands behind its last one afterwards.
        more: names that have a meaning only in this kind of file.
        persistent: what a persistent id stands for; no file of another kind has any.
    """

    def __init__(
        self,
        stream: Stream,
        more: Mapping[str, Callable[..., Any] | None] | None = None,
        persistent: Callable[[Any], Any] | None = None,
    ) -> None:
        super().__init__(stream, encoding="latin1")
        self.stream, self.persistent = stream, persistent
        self.names = NAMES | {WRAPPER: Wrapper} | dict(more or {})

    def load_raw(self) -> Any:  # noqa: ANN401
        """The object, in which arrays still are records."""
        return super().load()

    def find_class(self, module: str, name: str) -> Name:
        text = full_name(module, name)
        if text not in self.names:
            raise Refused(text)
        return Name(text, self.names[text])

    def persistent_load(self, pid: Any) -> Any:  # noqa: ANN401
        if self.persistent is None:
            raise Refused("a reference to something outside the file")
        return self.persistent(pid)

    def get_extension(self, code: int) -> None:
        raise Refused(f"extension code {code}")

    def _instantiate(self, klass: Name, args: list) -> None:
        self.append(_called(klass, tuple(args)))

    # The opcodes, by the names that the base gives them.

    dispatch = dict(pickle._Unpickler.dispatch)

    def load_frame(self) -> None:
        self.read(8)  # a hint for reading ahead

    def load_reduce(self) -> None:
        args = self.stack.pop()
        self.stack[-1] = _called(self.stack[-1], args)

    def load_newobj(self) -> None:
        self.load_reduce()

    def load_newobj_ex(self) -> None:
        if self.stack.pop():
            raise Refused("a class that is made with named arguments")
        self.load_reduce()

    def load_build(self) -> None:
        state, record = self.stack.pop(), self.stack[-1]
        if not isinstance(record, Record):
            raise Refused(f"a state for {getattr(record, 'text', type(record).__name__)}")
        record.fill(state)
        if isinstance(record, Wrapper):
            record.read(self.stream)

    def load_bytearray8(self) -> None:
        self.append(self.read(unpack("<Q", self.read(8))[0]))

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        _mapping(self.stack[-1])[_key(key)] = value

    def load_setitems(self) -> None:
        items = self.pop_mark()
        mapping = _mapping(self.stack[-1])
        for key, value in zip(items[::2], items[1::2], strict=True):
            mapping[_key(key)] = value

    def load_dict(self) -> None:
        items = self.pop_mark()
        pairs = zip(items[::2], items[1::2], strict=True)
        self.append({_key(key): value for key, value in pairs})

    def load_frozenset(self) -> None:
        self.append(frozenset(_key(x) for x in self.pop_mark()))

    def load_additems(self) -> None:
        items = self.pop_mark()
        if not isinstance(self.stack[-1], set):
            raise Damaged("items are added to what is no set")
        self.stack[-1].update(_key(x) for x in items)

    def load_next_buffer(self) -> None:
        raise Refused("a buffer outside the file")


_REPLACED = {
    pickle.FRAME: Machine.load_frame, pickle.REDUCE: Machine.load_reduce,
    pickle.NEWOBJ: Machine.load_newobj, pickle.NEWOBJ_EX: Machine.load_newobj_ex,
    pickle.BUILD: Machine.load_build, pickle.BYTEARRAY8: Machine.load_bytearray8,
    pickle.SETITEM: Machine.load_setitem, pickle.SETITEMS: Machine.load_setitems,
    pickle.DICT: Machine.load_dict, pickle.FROZENSET: Machine.load_frozenset,
    pickle.ADDITEMS: Machine.load_additems, pickle.NEXT_BUFFER: Machine.load_next_buffer,
}  # fmt: skip
Machine.dispatch.update({code[0]: method for code, method in _REPLACED.items()})


def resolved(raw: Any, budget: Budget) -> Any:  # noqa: ANN401
    """A tree with records as the arrays they stand for; names that were only named are refused."""
    done: dict[int, Any] = {}
    alive = []  # ids stay taken as long as their objects live

    def resolve(x: Any) -> Any:  # noqa: ANN401
        if id(x) in done:
            return done[id(x)]
        if isinstance(x, Name):
            raise Refused(f"{x.text} as a value")
        if isinstance(x, Record):
            value = x.value(resolve, budget)
        elif isinstance(x, list):
            done[id(x)] = x  # a list may hold itself
            x[:] = [resolve(item) for item in x]
            value = x
        elif isinstance(x, dict):
            done[id(x)] = x
            for key in x:
                x[key] = resolve(x[key])
            value = x
        elif isinstance(x, tuple):
            value = tuple(resolve(item) for item in x)
        else:
            return x
        done[id(x)] = value
        alive.append(x)
        return value

    return resolve(raw)


def _called(name: Any, args: Any) -> Any:  # noqa: ANN401
    if not isinstance(name, Name) or name.call is None or not isinstance(args, tuple):
        raise Refused(f"a call of {getattr(name, 'text', type(name).__name__)}")
    return name.call(*args)


def _key(key: Any) -> Key:  # noqa: ANN401
    if isinstance(key, tuple) and all(isinstance(x, Key) for x in key):
        return key
    if not isinstance(key, Key):
        raise Refused(f"a key that is {type(key).__name__}, no text or number")
    return key


def _mapping(found: Any) -> dict:  # noqa: ANN401
    if not isinstance(found, dict):
        raise Damaged("a key is set in what is no dictionary")
    return found
