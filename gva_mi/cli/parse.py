"""Read a command's arguments with tyro, from its signature and its option dataclasses.

The range of a number (:mod:`gva_mi.core.options`) is shown in ``--help``. Every refused value ends
in one sentence that names the option. A command with ``--preset`` keeps the options of its presets
in an attribute ``presets``; they replace the defaults, so explicit options override them.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import io
import operator
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from tyro.conf import FlagCreatePairsOff, arg

from gva_mi.core.errors import InputError
from gva_mi.core.options import Within, python_only

if TYPE_CHECKING:
    from tyro.constructors import PrimitiveConstructorSpec, StructConstructorSpec, StructTypeInfo

NARROWEST_COLUMNS = 40  # of a terminal; in a narrower one tyro never finishes a long --help
Call = functools.partial[None]


def parse(command: Callable[..., None], verb: str, arguments: list[str]) -> Call:
    """Read a command's arguments; return the call without making it.

    Errors raised here are about the arguments; errors of the command come with the call.

    Raises:
        InputError: a value that cannot be read or that the options refuse.
    """
    if shutil.get_terminal_size().columns < NARROWEST_COLUMNS:
        os.environ["COLUMNS"] = str(NARROWEST_COLUMNS)
    signature = inspect.signature(command)
    call = _read(command, signature, verb, arguments)
    presets = getattr(command, "presets", {})
    if (preset := call.keywords.get("preset")) in presets:
        parameters = dict(signature.parameters)
        parameters["options"] = parameters["options"].replace(default=presets[preset])
        signature = signature.replace(parameters=list(parameters.values()))
        call = _read(command, signature, verb, arguments)
    _require_inputs_to_stay(signature.bind(*call.args, **call.keywords).arguments)
    return call


def _read(
    command: Callable[..., None], signature: inspect.Signature, verb: str, arguments: list[str]
) -> Call:
    """Let tyro read the arguments; turn its errors of values into sentences."""
    import tyro

    def call(*values: object, **options: object) -> Call:
        return functools.partial(command, *values, **options)

    numbers, printed = _Numbers(), io.StringIO()
    hints = get_type_hints(command, include_extras=True)
    call.__annotations__ = {name: _named(name, numbers.in_(hint)) for name, hint in hints.items()}
    call.__signature__ = signature
    call.__doc__ = re.sub(r"\n {12}", " ", command.__doc__ or "")  # tyro keeps line breaks of Args
    registry = tyro.constructors.ConstructorRegistry()
    registry.struct_rule(numbers.in_fields)
    try:
        with redirect_stderr(printed):
            return tyro.cli(
                call, prog=f"gva-mi {verb}", args=arguments, registry=registry,
                config=(tyro.conf.SuppressFixed,),
            )  # fmt: skip
    except ValueError as error:  # from options without a prefix, which tyro does not catch
        raise InputError(str(error)) from None
    except SystemExit as stop:
        sentence = _refusal(stop, numbers.refused)
        if sentence is not None:
            raise InputError(sentence) from None
        sys.stderr.write(printed.getvalue())  # missing or unknown arguments, or no such choice
        raise


def _require_inputs_to_stay(given: Mapping[str, object]) -> None:
    """Raise an InputError for an input inside the folder that ``--overwrite`` would remove."""
    out = given.get("out")
    if not (given.get("overwrite") and isinstance(out, Path) and out.is_dir()):
        return
    for path in _paths([value for name, value in given.items() if name != "out"]):
        if path.exists() and path.resolve().is_relative_to(out.resolve()):
            raise InputError(
                f"{path}: lies in {out}, which --overwrite would remove; move it, or choose "
                "another --out"
            )


def _paths(value: object) -> Iterator[Path]:
    """Yield all paths in arguments, lists of them and option dataclasses."""
    if isinstance(value, Path):
        yield value
    elif dataclasses.is_dataclass(value):
        yield from _paths(list(vars(value).values()))
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _paths(one)


def _named(name: str, hint: Any) -> Any:  # noqa: ANN401
    """Return an annotation that shows a positional argument by its name, unless it is a choice."""
    from tyro.conf import Positional, arg

    kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if get_args(Positional[Path])[1] not in marks or get_origin(kind) is Literal:
        return hint
    several = " ..." if get_origin(kind) in (list, tuple) else ""
    return Annotated[hint, arg(metavar=name.upper() + several)]


class _Numbers:
    """How tyro reads and shows bounded numbers.

    Attributes:
        refused: expected range and given value of each refused number.
    """

    def __init__(self) -> None:
        self.refused: list[str] = []
        self._in_tyros_rule = False

    def in_fields(self, info: StructTypeInfo) -> StructConstructorSpec | None:
        """Let tyro read a dataclass, with ranges, and without what only Python sets."""
        from tyro.conf import Fixed
        from tyro.constructors import ConstructorRegistry

        if self._in_tyros_rule or not dataclasses.is_dataclass(info.type):
            return None
        self._in_tyros_rule = True  # skip this rule, so that tyro's own applies
        spec = ConstructorRegistry.get_struct_spec(info)
        self._in_tyros_rule = False
        hidden, fields = python_only(info.type), []
        for field in spec.fields:
            hint = Annotated[field.type, Fixed] if field.name in hidden else self.in_(field.type)
            fields.append(dataclasses.replace(field, type=hint))
        return dataclasses.replace(spec, fields=tuple(fields))

    def in_(self, hint: Any) -> Any:  # noqa: ANN401
        """Return an annotation in which tyro's specification replaces each range."""
        if get_origin(hint) is Annotated:
            kind, *rest = get_args(hint)
            rest = (self._number(kind, x) if isinstance(x, Within) else x for x in rest)
            return Annotated[(self.in_(kind), *rest)]
        parts = get_args(hint)
        if not any(get_args(part) for part in parts):
            return hint
        parts = tuple(map(self.in_, parts))
        return tuple[parts] if get_origin(hint) is tuple else functools.reduce(operator.or_, parts)

    def _number(self, kind: type[int] | type[float], within: Within) -> PrimitiveConstructorSpec:
        from tyro.constructors import PrimitiveConstructorSpec

        def read(words: list[str]) -> float:
            try:
                number = kind(words[0])
            except ValueError:
                number = None
            if number not in within:
                form = "a whole number" if kind is int else "a number"
                self.refused.append(f"must be {form} {within}, got {words[0] or 'nothing'}")
                raise ValueError(self.refused[-1])
            return number

        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=f"{kind.__name__.upper()} {within}",
            instance_from_str=read,
            is_instance=lambda found: isinstance(found, int | float),
            str_from_instance=lambda found: [str(found)],
        )


def _refusal(stop: SystemExit, refused: list[str]) -> str | None:
    """Return the sentence for a refused value; None if tyro stopped for another reason.

    Python keeps tyro's error and the value's error as contexts of the exit. Only tyro's error
    knows which option a number belongs to; option classes name the option in their own errors.
    """
    error, option = stop.__context__, None
    while error is not None and not isinstance(error, ValueError):
        lowered = getattr(getattr(error, "arg", None), "lowered", None)
        option = lowered.name_or_flags[-1] if lowered is not None else option
        error = error.__context__
    if error is None:
        return None
    named = option is not None and option.startswith("--")
    reason = refused[-1] if refused and (named or str(error) == refused[-1]) else str(error)
    return f"{option} {reason}" if named else reason


MOST_PEOPLE = 20  # in a video, for --person; chosen: more people are too small in the picture

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line
Switch = Annotated[bool, FlagCreatePairsOff]  # off by default and without a --no-... form


def given(options: object) -> dict[str, str]:
    """Return the fields that differ from the defaults, and their options."""
    usual = vars(type(options)())
    differ = (name for name, value in vars(options).items() if value != usual[name])
    return {name: f"--{name.replace('_', '-')}" for name in differ}


def nth_person(text: str | None) -> int | None:
    """Return the person of a video that ``--person`` names, from the left; None: the largest."""
    if text is not None and not (text.isdecimal() and 1 <= int(text) <= MOST_PEOPLE):
        raise InputError(
            f"--person of a video must be a number from 1 to {MOST_PEOPLE}, from the left; "
            f"got {text}"
        )
    return None if text is None else int(text)
