"""Kernels that are traced once: ``dr.freeze``, with the constants of the code kept apart.

A frozen function replays what it did at its first call, as long as its arguments look the same.
Arrays may change in size and values. Python numbers and strings may not: they are constants of the
code, and another value is another recording. Dr.Jit 1.5.0 compares them badly: a constant that
equals an earlier one of the same call is not looked at, so that ``f(x, False, True, True)`` and
``f(x, False, True, False)`` share a recording, and the second gives the first one's result. So
constants are keyword arguments here, and every set of them has a frozen function of its own.

While ``dr.freeze`` looks through arguments and results it holds Dr.Jit's lock. For a dataclass it
runs Python code, in which another thread may take its turn; one that frees an array then waits for
Dr.Jit's lock, and this one for its next turn, for ever. Through lists it goes without running
Python. So it gets flat lists of arrays; the records around them are taken off and put on here.

While a function is traced Python collects no garbage. A collection may free what is not ours, such
as a Mitsuba scene whose ray tracer is taken down on Dr.Jit's queue; within a recording that ends
the process.
"""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import Any

import drjit as dr

LIMIT = 64  # sets of constants that are kept, and recordings of each

Shape = tuple[type, Any] | None  # of nested records, hashable: a type, and its parts; None: array
Key = tuple[Shape, tuple[tuple[str, Any], ...]]  # of the arrays, and the constants by name


class Frozen:
    """A function of arrays (positional) and constants (keywords, hashable), traced once.

    Arrays may lie in lists, tuples and dataclasses; what else lies there is a constant too.
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
        self.variants[key] = variant  # used last, it is forgotten last
        if len(self.variants) > LIMIT:
            oldest = next(iter(self.variants))
            del self.variants[oldest], self.results[oldest]
        with _no_garbage_collected():
            found = variant(leaves)
        return _unflatten(self.results[key], iter(found))

    def _of_leaves(self, key: Key) -> Callable[[list[dr.ArrayBase]], list[dr.ArrayBase]]:
        """The function of flat arrays alone.

        Constants are defaults of its arguments and no closure: what a closure holds, ``dr.freeze``
        looks through at every call.
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
    """Marks a part that holds no array."""


@functools.cache  # dr.ArrayBase takes its time to say what is one
def _role(kind: type) -> str:
    """What a value of some type is to :func:`_flatten`."""
    if issubclass(kind, dr.ArrayBase):
        return "array"
    if issubclass(kind, list | tuple):
        return "sequence"
    return "record" if is_dataclass(kind) else "constant"


def _flatten(value: Any, leaves: list[dr.ArrayBase]) -> Shape:  # noqa: ANN401
    """Append the arrays of nested records to ``leaves``; returns what is left without them."""
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
    """The reverse of :func:`_flatten`."""
    if shape is None:
        return next(leaves)
    kind, parts = shape
    if kind is _Constant:
        return parts
    values = [_unflatten(part, leaves) for part in parts]
    return kind(values) if kind in (list, tuple) else kind(*values)


@contextmanager
def _no_garbage_collected() -> Iterator[None]:
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
