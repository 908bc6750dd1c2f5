"""The range of an option, stated once, beside its type::

    steps: Annotated[int, Within(1, 1_000_000)] = 3000

The command line tells it in ``--help`` and refuses what lies outside under the option's own name;
:func:`require_ranges` does the same for whoever makes the options in Python. Every range has two
finite ends, so that neither NaN nor infinity lies in any.
"""

from __future__ import annotations

import functools
import numbers
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from gva_mi.errors import InputError


@dataclass(frozen=True)
class Within:
    """The numbers between two finite ends, which belong to them where ``open`` does not say so."""

    low: float
    high: float
    open: str = ""  # "low" or "low high": ends that are left out
    unit: str = ""  # such as metres, for people

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
        """Raise an InputError for what lies outside."""
        if number not in self:
            raise InputError(f"{where}: {name} must be {self}, got {number}")


Share = Annotated[float, Within(0, 1)]
InnerShare = Annotated[float, Within(0, 1, "low high")]
Weight = Annotated[float, Within(0, 1e6)]
Rate = Annotated[float, Within(0, 1)]
Seed = Annotated[int, Within(0, 2**32 - 1)]
Workers = Annotated[int, Within(1, 256)]
Metres = Annotated[float, Within(0, 10, "low")]  # in a step, or of a detail of a person
Turn = Annotated[float, Within(0, 10, "low")]  # radians in a step
PictureSide = Annotated[int, Within(16, 4096, unit="pixels")]  # of a picture


def require_ranges(where: str, options: object) -> None:
    """Raise an InputError for the first field of a dataclass that lies outside its range.

    Args:
        where: the command that the options are of, for the sentence.
        options: a dataclass whose annotations name ranges; a field of None is left alone.
    """
    for name, kind, within in _ranges_of(type(options)):
        for value in _listed(getattr(options, name)):
            within.require(where, name, value)
            if kind is int and value != int(value):
                raise InputError(f"{where}: {name} must be a whole number, got {value}")


def ranges(hint: Any) -> Iterator[tuple[Any, Within]]:  # noqa: ANN401
    """Kinds of number and ranges anywhere in an annotation, as in ``tuple[Share, ...] | None``."""
    kind, *rest = get_args(hint) or (hint,)
    if get_origin(hint) is Annotated:
        yield from ((kind, part) for part in rest if isinstance(part, Within))
    for part in get_args(hint):
        if get_args(part):
            yield from ranges(part)


@functools.cache
def _ranges_of(of: type) -> tuple[tuple[str, Any, Within], ...]:
    """Fields of a dataclass, and the kinds of number and ranges of each."""
    hints = get_type_hints(of, include_extras=True)
    return tuple((name, *found) for name, hint in hints.items() for found in ranges(hint))


def _listed(value: Any) -> tuple[Any, ...]:  # noqa: ANN401
    if value is None:
        return ()
    return tuple(value) if isinstance(value, tuple | list) else (value,)
