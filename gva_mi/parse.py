"""Arguments of the command line: read by tyro from a command's signature and its options.

What :mod:`gva_mi.ranges` says of a number is told in ``--help`` beside its kind, and a number that
lies outside is refused under the name that it has on the command line.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import io
import operator
import re
import sys
from collections.abc import Callable
from contextlib import redirect_stderr
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

from gva_mi.errors import InputError
from gva_mi.ranges import Within

if TYPE_CHECKING:
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec


Refused = list[str]  # what an option must be, and what it is: of numbers that were refused


def parse(command: Callable[..., None], program: str, arguments: list[str]) -> Callable[[], None]:
    """Read a command's arguments, and return the call without making it.

    So whatever is raised here is about the arguments, and what the command raises later is not.

    Raises:
        InputError: a value that cannot be read, or that options refuse.
    """
    import tyro

    def call(*values: object, **options: object) -> Callable[[], None]:
        return functools.partial(command, *values, **options)

    complaint, refused = io.StringIO(), Refused()
    hints = get_type_hints(command, include_extras=True)
    call.__annotations__ = {name: _told(hint, refused) for name, hint in hints.items()}
    call.__signature__, call.__doc__ = inspect.signature(command), command.__doc__
    try:
        with redirect_stderr(complaint):
            return tyro.cli(call, prog=program, args=arguments, registry=_registry(refused))
    except ValueError as error:  # of options without a prefix, which tyro lets through
        raise InputError(str(error)) from None
    except SystemExit as stop:
        refusal = _refusal(stop)
        if refusal is not None:
            raise InputError(_sentence(refusal, complaint.getvalue(), refused)) from None
        sys.stderr.write(complaint.getvalue())  # arguments that are missing, unknown, no choice
        raise


def _registry(refused: Refused) -> ConstructorRegistry:
    """A rule for tyro: options are read as ever, the ranges of their numbers told."""
    from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructTypeInfo

    registry, asked = ConstructorRegistry(), []

    @registry.struct_rule
    def with_ranges(info: StructTypeInfo) -> StructConstructorSpec | None:
        if asked or not dataclasses.is_dataclass(info.type):
            return None
        asked.append(info)  # so that tyro's own rule is the one that answers
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            asked.clear()
        told = lambda field: dataclasses.replace(field, type=_told(field.type, refused))
        return dataclasses.replace(spec, fields=tuple(map(told, spec.fields)))

    return registry


def _told(hint: Any, refused: Refused) -> Any:  # noqa: ANN401
    """An annotation with tyro's words in the place of each range."""
    if get_origin(hint) is Annotated:
        kind, *rest = get_args(hint)
        told = (_number(kind, x, refused) if isinstance(x, Within) else x for x in rest)
        return Annotated[(_told(kind, refused), *told)]
    parts = get_args(hint)
    if not parts or not any(get_args(part) for part in parts):
        return hint
    told = tuple(_told(part, refused) for part in parts)
    return tuple[told] if get_origin(hint) is tuple else functools.reduce(operator.or_, told)


def _number(
    kind: type[int] | type[float], within: Within, refused: Refused
) -> PrimitiveConstructorSpec:
    """How tyro reads and tells a number of some range."""
    from tyro.constructors import PrimitiveConstructorSpec

    def read(words: list[str]) -> float:
        try:
            number = kind(words[0])
        except ValueError:
            number = None
        if number not in within:
            form = "a whole number" if kind is int else "a number"
            refused.append(f"must be {form} {within}, got {words[0]}")
            raise ValueError(refused[-1])
        return number

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{kind.__name__.upper()} {within}",
        instance_from_str=read,
        is_instance=lambda found: isinstance(found, int | float),
        str_from_instance=lambda found: [str(found)],
    )


def _refusal(stop: SystemExit) -> ValueError | None:
    """The error of a value for which tyro stopped, which Python keeps as the context of the exit.

    tyro draws a frame around this error's sentence and breaks its lines; the error has it whole.
    """
    error: BaseException | None = stop
    while error is not None and not isinstance(error, ValueError):
        error = error.__context__
    return error


def _sentence(refusal: ValueError, text: str, refused: Refused) -> str:
    """What was wrong, with the option's name where tyro's text tells it.

    Options refuse a value in a sentence that names them, but a number of the wrong form does not
    know which option it stood for. Then tyro's text has "Error parsing --steps:". Were its wording
    to change, the sentence would lack the name.
    """
    named = re.search(r"Error parsing (--[\w.-]+)", re.sub(r"\x1b\[[\d;]*m", "", text))
    reason = refused[-1] if refused and (named or str(refusal) == refused[-1]) else str(refusal)
    return f"{named.group(1)} {reason}" if named else reason
