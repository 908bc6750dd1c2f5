"""Kernels that are traced once (``dr.freeze``), and the lock that every entry point takes.

A frozen function replays its first call as long as its arguments look the same. Arrays may change
in size and values. Python numbers and strings may not: they are constants of the code, and another
value needs another recording. Dr.Jit 1.5.0 compares them wrongly: it ignores a constant that equals
an earlier one of the same call. So ``f(x, False, True, True)`` and ``f(x, False, True, False)``
share a recording, and the second call returns the first one's result. Therefore constants are
keyword arguments here, and every set of constants has a frozen function of its own.

A replay infers the number of lanes from the arrays that its kernels read: one that is read lane by
lane, or whose size is a fixed multiple of the lanes. An array of which only the width is used does
not count. If no array tells, a replay of another size is silently wrong.

``dr.freeze`` holds Dr.Jit's lock while it traverses arguments and results. For a dataclass it runs
Python code, during which another thread may run. If that thread frees an array, it waits for
Dr.Jit's lock while this one waits for Python's: a deadlock. Lists are traversed without Python
code. So ``dr.freeze`` gets flat lists of arrays, and the records are flattened and rebuilt here.

Python's garbage collector is off during a call. A collection may free a Mitsuba scene, which
releases its ray tracer by a function on Dr.Jit's queue. Dr.Jit cannot record that; it raises
(``enqueue_host_func(): this function cannot be recorded!``) in a destructor, which ends the
process. References of ours would not help, because the scene may belong to the caller.

``dr.freeze`` of Dr.Jit 1.5.0 is not made for threads: two that record or replay at once end the
process (``jit_var(r14): unknown variable!``). So every pass, forward, adjoint or tangent, holds the
lock :data:`exclusive` from its first array to its last. Nothing is lost, because the kernels use
all cores themselves.

Threads enter in the order in which they came. So a viewer that draws all the time leaves every
other turn to a training beside it. Python's own locks would let the thread that just left in again.

The lock covers this library. A program that freezes functions of its own, or runs Dr.Jit's autodiff
or Mitsuba in another thread than the one that renders, holds it there too::

    with exclusive:
        image = mi.render(scene)

A process forked from one that had imported Dr.Jit lacks Dr.Jit's threads and would wait for them
forever. A ``DataLoader``'s workers may be forked as long as they do not render.
"""

from __future__ import annotations

import functools
import gc
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator, contextmanager
from dataclasses import is_dataclass
from typing import Any

import drjit as dr

# Sets of constants to keep, and recordings of each. Chosen: it bounds the memory of a program that
# changes a constant at every call.
MAX_RECORDINGS = 64

Shape = tuple[type, Any] | None  # of nested records, hashable: a type and its parts; None: array
Key = tuple[Shape, tuple[tuple[str, Any], ...]]  # of the arrays, and the constants by name
# Seconds after which a waiting thread looks for a Ctrl-C: Python does not notice one that comes
# just before a lock starts to wait. Chosen: short for a person, long for the CPU.
CTRL_C_SECONDS = 0.5


class Frozen:
    """A function of arrays (positional) and constants (keywords, hashable), traced once.

    Arrays may be in lists, tuples and dataclasses; everything else in there is a constant too.

    Example:
        >>> from drjit.llvm import Float
        >>> @Frozen
        ... def scaled(x, *, factor):
        ...     print("traced")
        ...     return x * factor
        >>> numbers = Float(1, 2, 3)
        >>> [scaled(numbers, factor=2)[2] for _ in range(3)]
        traced
        [6.0, 6.0, 6.0]
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
            variant = dr.freeze(self._of_leaves(key), limit=MAX_RECORDINGS, warn_after=1000)
        self.variants[key] = variant  # the least recently used one is dropped first
        if len(self.variants) > MAX_RECORDINGS:
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


class Exclusive(ContextDecorator):
    """A reentrant lock, first come, first served, as a context manager and as a decorator.

    Example:
        >>> lock = Exclusive()
        >>> with lock, lock:
        ...     print("inside")
        inside
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()  # of the queue
        self._queue: deque[threading.Lock] = deque()  # the turn of the thread inside, then others'
        self._inside: int | None = None  # the thread
        self._depth = 0  # number of times it entered
        self._forked = False
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._note_fork)

    def __enter__(self) -> None:
        if self._forked:
            raise RuntimeError(
                "render(): this process was forked from one that had imported Dr.Jit, whose "
                "threads stayed there: render in that one, or start workers with "
                "multiprocessing's 'spawn'"
            )
        if self._inside == threading.get_ident():
            self._depth += 1
            return
        turn = threading.Lock()
        try:
            with self._guard:
                if self._queue:
                    turn.acquire()  # the thread before releases it
                self._queue.append(turn)
            while not turn.acquire(timeout=CTRL_C_SECONDS):
                pass
            self._inside, self._depth = threading.get_ident(), 1
        except BaseException:  # Ctrl-C while waiting
            self._leave(turn)
            raise

    def __exit__(self, *_: object) -> None:
        if self._depth > 1:
            self._depth -= 1
            return
        self._inside = None
        self._leave(self._queue[0])

    def _leave(self, turn: threading.Lock) -> None:
        """Leave the queue, and let the next thread in if this one was the first."""
        with self._guard:
            first = bool(self._queue) and self._queue[0] is turn
            if turn in self._queue:
                self._queue.remove(turn)
            if first and self._queue:
                self._queue[0].release()

    def _note_fork(self) -> None:
        self._forked = True


exclusive = Exclusive()
