"""Kernels that are traced once: ``dr.freeze``, with the constants of the code kept apart.

A frozen function replays what it did at its first call, as long as its arguments look the same.
Arrays may change in size and values. Python numbers and strings may not: they are constants of the
code, and another value is another recording. Dr.Jit 1.5.0 compares them badly: a constant that
equals an earlier one of the same call is not looked at, so that ``f(x, False, True, True)`` and
``f(x, False, True, False)`` share a recording, and the second gives the first one's result. So
constants are keyword arguments here, and every set of them has a frozen function of its own.

While a function is traced Python collects no garbage. A collection may free what is not ours, such
as a Mitsuba scene whose ray tracer is taken down on Dr.Jit's queue; within a recording that ends
the process.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr

LIMIT = 64  # sets of constants that are kept, and recordings of each


class Frozen:
    """A function of arrays (positional) and constants (keywords, hashable), traced once."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.variants: dict[tuple[tuple[str, Any], ...], Callable[..., Any]] = {}
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def __call__(self, *arrays: Any, **constants: Any) -> Any:  # noqa: ANN401
        key = tuple(constants.items())
        variant = self.variants.pop(key, None)
        if variant is None:
            variant = dr.freeze(self._with(constants), limit=LIMIT, warn_after=1000)
        self.variants[key] = variant  # used last, it is forgotten last
        if len(self.variants) > LIMIT:
            del self.variants[next(iter(self.variants))]
        with _no_garbage_collected():
            return variant(*arrays)

    def _with(self, constants: dict[str, Any]) -> Callable[..., Any]:
        """The function of arrays alone.

        Constants are defaults of its arguments and no closure: what a closure holds, ``dr.freeze``
        looks through at every call.
        """

        def run(
            *arrays: Any,  # noqa: ANN401
            function: Callable[..., Any] = self.function,
            constants: dict[str, Any] = constants,
        ) -> Any:  # noqa: ANN401
            return function(*arrays, **constants)

        return run


@contextmanager
def _no_garbage_collected() -> Iterator[None]:
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
