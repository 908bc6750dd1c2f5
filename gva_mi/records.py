"""Dataclasses from JSON, each field of the kind that its annotation says.

A file may be damaged, or of another version of this program: text in the place of a number would be
found out by whoever computes with it, far from the file.
"""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


def from_json(kind: type[T], record: Any) -> T:  # noqa: ANN401
    """A dataclass of what JSON said.

    Args:
        kind: the dataclass, of numbers, text, lists, dictionaries, and other dataclasses.
        record: names and values; a name that is missing takes the field's default.

    Raises:
        TypeError, ValueError: a value is of another kind, a name is missing or not known. Readers
            turn them into a sentence: :func:`gva_mi.errors.expecting`.
    """
    if not isinstance(record, Mapping):
        raise TypeError(f"{_short(record)} in the place of a {kind.__name__}")
    hints = _hints(kind)
    values = {
        name: require(hints[name], value, name) if name in hints else value
        for name, value in record.items()
    }
    return kind(**values)


def require(hint: Any, value: Any, name: str) -> Any:  # noqa: ANN401
    """A value of JSON as what an annotation says: a list as a tuple, a dictionary as a dataclass.

    Args:
        hint: such as ``float | None``.
        value: what JSON said.
        name: of the field, for the error.

    Raises:
        TypeError: it is of another kind.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return require(parts[0], value, name)
    if origin in (Union, types.UnionType):
        return _one_of(parts, value, name)
    if dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else from_json(hint, value)
    if origin is tuple and isinstance(value, list | tuple):  # of one kind, or of so many
        if parts[-1] is not Ellipsis and len(parts) != len(value):
            raise TypeError(f"'{name}' has {len(value)} values, not {len(parts)}")
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        return tuple(require(kind, x, name) for kind, x in zip(kinds, value, strict=True))
    if origin is list and isinstance(value, list):
        return [require(parts[0], x, name) for x in value]
    if origin in (dict, Mapping) and isinstance(value, Mapping):
        return {key: require(parts[1], x, f"{name}.{key}") for key, x in value.items()}
    if not _is(hint, value):
        raise TypeError(f"'{name}' is {_short(value)}")
    return value


def _one_of(kinds: tuple[Any, ...], value: Any, name: str) -> Any:  # noqa: ANN401
    """A value of one of several kinds; the last one's error where it is of none."""
    for kind in kinds[:-1]:
        try:
            return require(kind, value, name)
        except TypeError:
            continue
    return require(kinds[-1], value, name)


def _is(hint: Any, value: Any) -> bool:  # noqa: ANN401
    """Whether a value is of a plain kind."""
    if hint is Any:
        return True
    if get_origin(hint) is Literal:
        return isinstance(value, str | int) and value in get_args(hint)
    if hint is None or hint is type(None):
        return value is None
    if hint in (int, float) and isinstance(value, bool):
        return False
    return isinstance(value, int | float if hint is float else hint)


def _short(value: Any) -> str:  # noqa: ANN401
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]} ..."


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)
