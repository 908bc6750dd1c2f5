"""Kernels that are traced once: ``dr.freeze``, with constants kept apart from arrays.

A frozen function replays its first call as long as its arguments look the same. Arrays may change
in size and values. Python numbers and strings may not: they are constants of the code, and another
value needs another recording. Dr.Jit 1.5.0 compares them wrongly: it ignores a constant that equals
an earlier one of the same call. So ``f(x, False, True, True)`` and ``f(x, False, True, False)``
share a recording, and the second call returns the first one's result. Therefore constants are
keyword arguments here, and every set of constants has a frozen function of its own.

``dr.freeze`` holds Dr.Jit's lock while it traverses arguments and results. For a dataclass it runs
Python code, during which another thread may run. If that thread frees an array, it waits for
Dr.Jit's lock while this one waits for Python's: a deadlock. Lists are traversed without Python
code. So ``dr.freeze`` gets flat lists of arrays, and the records are flattened and rebuilt here.

Python's garbage collection is off while a function is traced. It may free objects of others, such
as a Mitsuba scene whose ray tracer is destroyed on Dr.Jit's queue; during a recording that ends the
process.
"""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import Any

import drjit as dr

LIMIT = 64  # sets of constants to keep, and recordings of each

Shape = tuple[type, Any] | None  # of nested records, hashable: a type and its parts; None: array
Key = tuple[Shape, tuple[tuple[str, Any], ...]]  # of the arrays, and the constants by name


class Frozen:
    """A function of arrays (positional) and constants (keywords, hashable), traced once.

    Arrays may be in lists, tuples and dataclasses; everything else in there is a constant too.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.variants: dict[Key, Callable[..., Any]] = {}
        self.results: dict[Key, Shape] = {}
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def __call__(self, *arrays: Any, **constants: Any) -> Any:  # noqa: ANN401
        leaves: list[dr.ArrayBase] = []
        key = (_flatten(arrays, leaves), tuple(constants.items()))
        variant = self.variants.pop(key, None)
        if variant is None:
            variant = dr.freeze(self._of_leaves(key), limit=LIMIT, warn_after=1000)
        self.variants[key] = variant  # the least recently used one is dropped first
        if len(self.variants) > LIMIT:
            oldest = next(iter(self.variants))
            del self.variants[oldest], self.results[oldest]
        with _without_garbage_collection():
            found = variant(leaves)
        return _unflatten(self.results[key], iter(found))

    def _of_leaves(self, key: Key) -> Callable[[list[dr.ArrayBase]], list[dr.ArrayBase]]:
        """Return the function of flat arrays.

        Constants are default arguments, not a closure: ``dr.freeze`` traverses a closure at every
        call.
        """

        def run(
            leaves: list[dr.ArrayBase],
            function: Callable[..., Any] = self.function,
            key: Key = key,
            results: dict[Key, Shape] = self.results,
        ) -> list[dr.ArrayBase]:
            shape, constants = key
            found: list[dr.ArrayBase] = []
            whole = function(*_unflatten(shape, iter(leaves)), **dict(constants))
            results[key] = _flatten(whole, found)
            return found

        return run


class _Constant:
    """Marks a part that is not an array."""


@functools.cache  # isinstance of dr.ArrayBase is slow
def _role(kind: type) -> str:
    """Classify a type for :func:`_flatten`."""
    if issubclass(kind, dr.ArrayBase):
        return "array"
    if issubclass(kind, list | tuple):
        return "sequence"
    return "record" if is_dataclass(kind) else "constant"


def _flatten(value: Any, leaves: list[dr.ArrayBase]) -> Shape:  # noqa: ANN401
    """Append the arrays of nested records to ``leaves``; return the structure without them."""
    kind = type(value)
    role = _role(kind)
    if role == "array":
        leaves.append(value)
        return None
    if role == "constant":
        return _Constant, value
    parts = vars(value).values() if role == "record" else value
    return kind, tuple([_flatten(part, leaves) for part in parts])


def _unflatten(shape: Shape, leaves: Iterator[dr.ArrayBase]) -> Any:  # noqa: ANN401
    """Reverse of :func:`_flatten`."""
    if shape is None:
        return next(leaves)
    kind, parts = shape
    if kind is _Constant:
        return parts
    values = [_unflatten(part, leaves) for part in parts]
    return kind(values) if kind in (list, tuple) else kind(*values)


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
