"""Options as dataclasses: the range of each number, stated once beside its type, and JSON.

::

    steps: Annotated[int, Within(1, 1_000_000)] = 3000

The command line shows the range in ``--help`` and refuses other numbers; :func:`options_of` does
the same for options made in Python. Both ends are finite, so NaN and infinity are in no range.
A field that is ``PythonOnly[...]`` is not an option of a command.

Example:
    >>> @options_of("walk")
    ... class WalkOptions:
    ...     steps: Annotated[int, Within(1, 100)] = 10
    >>> WalkOptions(steps=0)
    Traceback (most recent call last):
    gva_mi.core.errors.InputError: walk: steps must be from 1 to 100, got 0
"""

from __future__ import annotations

import dataclasses
import functools
import numbers
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from gva_mi.core.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Within:
    """The numbers between two finite ends, which are included unless ``open`` names them."""

    low: float
    high: float
    open: str = ""  # "low" or "low high": excluded ends
    unit: str = ""  # such as metres; shown in --help

    def __contains__(self, number: object) -> bool:
        if isinstance(number, bool) or not isinstance(number, numbers.Real):
            return False
        above = number > self.low if "low" in self.open else number >= self.low
        below = number < self.high if "high" in self.open else number <= self.high
        return above and below

    def __str__(self) -> str:
        low, high = (f"{end:,.10g}" for end in (self.low, self.high))
        above = f"above {low}" if "low" in self.open else f"from {low}"
        below = "to" if not self.open else "and below" if "high" in self.open else "and at most"
        return f"{above} {below} {high} {self.unit}".rstrip()

    def require(self, where: str, name: str, number: object) -> None:
        """Raise an InputError for a number outside."""
        if number not in self:
            raise InputError(f"{where}: {name} must be {self}, got {number}")


_PYTHON_ONLY = object()  # marks a field that is :data:`PythonOnly`
PythonOnly = Annotated[T, _PYTHON_ONLY]  # set from Python alone, not by an option of a command

Share = Annotated[float, Within(0, 1)]
InnerShare = Annotated[float, Within(0, 1, "low high")]
Weight = Annotated[float, Within(0, 1e6)]
Rate = Annotated[float, Within(0, 1)]
Seed = Annotated[int, Within(0, 2**32 - 1)]
Workers = Annotated[int, Within(1, 256)]
Metres = Annotated[float, Within(0, 10, "low")]  # a step, or the size of a detail of a person
Turn = Annotated[float, Within(0, 10, "low")]  # radians per step
PictureSide = Annotated[int, Within(16, 4096, unit="pixels")]


@dataclass_transform(frozen_default=True)
def options_of(command: str) -> Callable[[type[T]], type[T]]:
    """Make a class a frozen dataclass that raises an InputError for a number outside its range.

    ``command`` stands before the sentence. A ``__post_init__`` of the class comes after that check.
    """

    def decorate(kind: type[T]) -> type[T]:
        further = getattr(kind, "__post_init__", lambda self: None)

        def check(self: T) -> None:
            require_ranges(command, self)
            further(self)

        kind.__post_init__ = check
        return dataclass(frozen=True)(kind)

    return decorate


def require_ranges(where: str, options: object) -> None:
    """Raise an InputError for the first field of a dataclass that lies outside its range.

    ``where`` names the command in the sentence. Fields that are None are skipped.
    """
    for name, kind, within in _ranges_of(type(options)):
        value = getattr(options, name)
        values = value if isinstance(value, tuple | list) else () if value is None else (value,)
        for one in values:
            within.require(where, name, one)
            if kind is int and one != int(one):
                raise InputError(f"{where}: {name} must be a whole number, got {one}")


@functools.cache
def python_only(kind: type) -> frozenset[str]:
    """Return the names of a dataclass's fields that only Python sets."""
    marked = lambda hint: _PYTHON_ONLY in get_args(hint)[1:]
    return frozenset(name for name, hint in _hints(kind).items() if marked(hint))


def ranges(hint: Any) -> Iterator[tuple[Any, Within]]:  # noqa: ANN401
    """Yield type and range of each number in an annotation, as in ``tuple[Share, ...] | None``."""
    kind, *rest = get_args(hint) or (hint,)
    if get_origin(hint) is Annotated:
        yield from ((kind, part) for part in rest if isinstance(part, Within))
    for part in get_args(hint):
        if get_args(part):
            yield from ranges(part)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


@functools.cache
def _ranges_of(kind: type) -> tuple[tuple[str, Any, Within], ...]:
    """Return name, type and range of each ranged field of a dataclass."""
    return tuple((name, *found) for name, hint in _hints(kind).items() for found in ranges(hint))


def from_json(kind: type[T], record: Any) -> T:  # noqa: ANN401
    """Make a dataclass from parsed JSON; missing names take the field's default.

    Raises:
        ValueError: a value has another type, or a name is missing or unknown. Readers turn it into
            a sentence with :func:`gva_mi.core.errors.expecting`.
    """
    if not isinstance(record, dict):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise ValueError(f"expected {article} {kind.__name__}, got {_short(record)}")
    names = {field.name: field for field in dataclasses.fields(kind)}
    if unknown := record.keys() - names.keys():
        raise ValueError(f"'{min(unknown)}' is unknown")
    for name, field in names.items():
        if name not in record and {field.default, field.default_factory} == {dataclasses.MISSING}:
            raise ValueError(f"'{name}' is missing")
    hints = _hints(kind)
    return kind(**{k: _checked(hints[k], value, k) for k, value in record.items()})


def _checked(hint: Any, value: Any, name: str) -> Any:  # noqa: ANN401
    """Convert a JSON value to an annotated type: lists to tuples, dictionaries to dataclasses."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _checked(parts[0], value, name)
    if origin in (Union, types.UnionType):
        for kind in parts:
            with suppress(ValueError):
                return _checked(kind, value, name)
    elif dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else from_json(hint, value)
    elif origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            return tuple(_checked(kind, x, name) for kind, x in zip(kinds, value, strict=True))
    elif origin is list and isinstance(value, list):
        return [_checked(parts[0], x, name) for x in value]
    elif origin in (dict, Mapping) and isinstance(value, dict):
        return {key: _checked(parts[1], x, f"{name}.{key}") for key, x in value.items()}
    elif hint is Any or _is_plain(origin or hint, value, parts):
        return value
    raise ValueError(f"'{name}' is {_short(value)}")


def _is_plain(kind: Any, value: Any, choices: tuple) -> bool:  # noqa: ANN401
    """Return whether a value has a plain type, or is one of ``choices``; a bool is not a number."""
    if kind is Literal:
        return isinstance(value, str | int) and value in choices
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, int | float if kind is float else kind)


def _short(value: Any) -> str:  # noqa: ANN401
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]} ..."
