"""Unpickler with an allow-list: a name in a file stands for a constructor of ours, or is refused.

Nothing is imported and no attribute is looked up by a name in the file. Arrays are read in two
steps: the file fills a :class:`Shell`, and :func:`resolve` turns shells into arrays when all is
read, so that sizes are checked before anything is allocated.
"""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import BytesIO
from typing import Any

from gva_mi.core.arrays import Budget, Damaged, Refused


class Call:
    """A name in a file whose call makes a value at once; None if it can only be named."""

    __slots__ = ("make", "text")

    def __init__(self, text: str, make: Callable[..., Any] | None) -> None:
        self.text, self.make = text, make

    def __call__(self, *args: object) -> Any:  # noqa: ANN401
        if self.make is None:
            raise Refused(f"a call of {self.text}")
        return self.make(*args)

    def __setstate__(self, state: object) -> None:
        raise Refused(f"a state for {self.text}")


class Shell:
    """An object that a file makes first, of ``args``, and fills afterwards with a ``state``."""

    text: str  # its name in the file
    unpickler: Unpickler  # that reads it

    def __new__(cls, *args: object) -> Shell:
        """Make an empty one; the opcode NEWOBJ does not call ``__init__``."""
        self = super().__new__(cls)
        self.args, self.state = args, None
        return self

    def __setstate__(self, state: object) -> None:
        self.state = state

    def value(self, budget: Budget, state: Any, *args: Any) -> Any:  # noqa: ANN401
        """Return the array or value of this shell; ``state`` and ``args`` are resolved."""
        return state


class Unpickler(pickle.Unpickler):
    """Read one pickle from ``stream``; ``outside`` resolves references out of it.

    ``allowed`` names what a file may name: a kind of :class:`Shell`, or what :class:`Call` makes.
    """

    def __init__(
        self, stream: BytesIO, allowed: Mapping[str, Any], outside: Callable[[Any], Any] | None
    ) -> None:
        super().__init__(stream, encoding="latin1")
        self.stream, self.allowed, self.outside = stream, allowed, outside

    def find_class(self, module: str, name: str) -> type[Shell] | Call:
        module = {"__builtin__": "builtins", "copy_reg": "copyreg"}.get(module, module)
        text = f"{module}.{name}"
        if text not in self.allowed:
            raise Refused(text)
        found = self.allowed[text]
        if isinstance(found, type) and issubclass(found, Shell):
            return type(found.__name__, (found,), {"text": text, "unpickler": self})
        return Call(text, found)

    def persistent_load(self, pid: object) -> Any:  # noqa: ANN401
        if self.outside is None:
            raise Refused("a reference to something outside the file")
        return self.outside(pid)


def require_modest(data: bytes) -> None:
    """Refuse opcodes by which a damaged pickle makes the C unpickler allocate without bound.

    This is no protection from malice, which finds other ways to waste memory and time.

    Raises:
        Damaged: a memo index is larger than the file; or a DUP, which pickle never writes, might
            nest tuples so often that hashing them takes forever.
    """
    with suppress(ValueError):  # text of Python 2, and whatever the unpickler will refuse
        for op, arg, _ in pickletools.genops(data):
            if op.name == "DUP" or op.name.endswith("PUT") and arg > len(data):
                raise Damaged(f"opcode {op.name} {arg or ''}")


def resolve(root: Any, budget: Budget) -> Any:  # noqa: ANN401
    """Return a tree of containers with the value of each shell in its place."""
    done: dict[int, Any] = {}
    alive = []  # an id stays taken as long as its object lives

    def value_of(x: Any) -> Any:  # noqa: ANN401
        if id(x) in done:
            return done[id(x)]
        if isinstance(x, Call | type):
            raise Refused(f"{x.text} as a value")
        if isinstance(x, Shell):
            value = x.value(budget, value_of(x.state), *value_of(x.args))
        elif isinstance(x, list):
            done[id(x)] = value = x  # before its items, because a list may hold itself
            x[:] = map(value_of, x)
        elif isinstance(x, dict):
            done[id(x)] = value = x
            for key in x:
                x[key] = value_of(x[key])
        elif isinstance(x, tuple):
            value = tuple(map(value_of, x))
        else:
            return x
        done[id(x)] = value
        alive.append(x)
        return value

    return value_of(root)
