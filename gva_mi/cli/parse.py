"""Read a command's arguments with tyro, from its signature and its option dataclasses.

The range of a number (:mod:`gva_mi.core.options`) is shown in ``--help``. Every refused value ends
in one sentence that names the option.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import io
import operator
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

from gva_mi.cli.presets import with_preset
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within, python_only

if TYPE_CHECKING:
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec

NARROWEST = 40  # columns: in a narrower terminal tyro never finishes a long --help

# The options of its steps that `gva-mi study avatar` takes.
OF_STUDY = {"FitOptions": ("steps",), "SequenceOptions": ("passes", "size")}

Refusals = list[str]  # expected range and given value of each refused number


def parse(command: Callable[..., None], verb: str, arguments: list[str]) -> Callable[[], None]:
    """Read a command's arguments; return the call without making it.

    Errors raised here are about the arguments; errors of the command come with the call.

    Raises:
        InputError: a value that cannot be read or that the options refuse.
    """
    import tyro

    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)

    def call(*values: object, **options: object) -> Callable[[], None]:
        _require_inputs_to_stay(inspect.signature(command).bind(*values, **options).arguments)
        return functools.partial(command, *values, **options)

    told, refusals = io.StringIO(), Refusals()
    hints = get_type_hints(command, include_extras=True)
    call.__annotations__ = {
        name: _named(name, _with_ranges(hint, refusals)) for name, hint in hints.items()
    }
    call.__signature__ = with_preset(inspect.signature(command), verb, arguments)
    call.__doc__ = command.__doc__
    try:
        with redirect_stderr(told):
            return tyro.cli(
                call, prog=f"gva-mi {verb}", args=arguments, config=(tyro.conf.SuppressFixed,),
                registry=_registry(refusals, [verb, *arguments]),
            )  # fmt: skip
    except ValueError as error:  # from options without a prefix, which tyro does not catch
        raise InputError(str(error)) from None
    except SystemExit as stop:
        sentence = _refusal(stop, refusals)
        if sentence is not None:
            raise InputError(sentence) from None
        sys.stderr.write(told.getvalue())  # missing or unknown arguments, or no such choice
        raise


def _require_inputs_to_stay(given: Mapping[str, object]) -> None:
    """Raise an InputError for an input in the folder that ``--overwrite`` is about to remove."""
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
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _paths(one)
    elif dataclasses.is_dataclass(value):
        yield from _paths(list(vars(value).values()))


def _registry(refusals: Refusals, words: Sequence[str]) -> ConstructorRegistry:
    """Return a rule for tyro: show ranges of a dataclass's numbers, hide what only Python sets."""
    from tyro.conf import Fixed
    from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructTypeInfo

    registry, asked = ConstructorRegistry(), []

    @registry.struct_rule
    def with_ranges(info: StructTypeInfo) -> StructConstructorSpec | None:
        if asked or not dataclasses.is_dataclass(info.type):
            return None
        asked.append(info)  # so that tyro's own rule answers
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            asked.clear()
        type_of = lambda f: (
            _with_ranges(f.type, refusals)
            if _is_shown(info.type, f.name, words)
            else Annotated[f.type, Fixed]
        )
        fields = tuple(dataclasses.replace(f, type=type_of(f)) for f in spec.fields)
        return dataclasses.replace(spec, fields=fields)

    return registry


def _is_shown(kind: type, field: str, words: Sequence[str]) -> bool:
    """Return whether a field of a dataclass is an option of a command, given by its first words."""
    if list(words[:2]) == ["study", "avatar"] and kind.__name__ in OF_STUDY:
        return field in OF_STUDY[kind.__name__]
    return field not in python_only(kind)


def _with_ranges(hint: Any, refusals: Refusals) -> Any:  # noqa: ANN401
    """Return an annotation in which tyro's specification stands for each range."""
    if get_origin(hint) is Annotated:
        kind, *rest = get_args(hint)
        rest = (_number(kind, x, refusals) if isinstance(x, Within) else x for x in rest)
        return Annotated[(_with_ranges(kind, refusals), *rest)]
    parts = get_args(hint)
    if not parts or not any(get_args(part) for part in parts):
        return hint
    parts = tuple(_with_ranges(part, refusals) for part in parts)
    return tuple[parts] if get_origin(hint) is tuple else functools.reduce(operator.or_, parts)


def _named(name: str, hint: Any) -> Any:  # noqa: ANN401
    """Return an annotation that shows a positional argument by its name, unless it is a choice."""
    from tyro.conf import Positional, arg

    kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if get_args(Positional[Path])[1] not in marks or get_origin(kind) is Literal:
        return hint
    several = " ..." if get_origin(kind) in (list, tuple) else ""
    return Annotated[hint, arg(metavar=name.upper() + several)]


def _number(
    kind: type[int] | type[float], within: Within, refusals: Refusals
) -> PrimitiveConstructorSpec:
    """Return how tyro reads and shows a number of some range."""
    from tyro.constructors import PrimitiveConstructorSpec

    def read(words: list[str]) -> float:
        try:
            number = kind(words[0])
        except ValueError:
            number = None
        if number not in within:
            form = "a whole number" if kind is int else "a number"
            refusals.append(f"must be {form} {within}, got {words[0] or 'nothing'}")
            raise ValueError(refusals[-1])
        return number

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{kind.__name__.upper()} {within}",
        instance_from_str=read,
        is_instance=lambda found: isinstance(found, int | float),
        str_from_instance=lambda found: [str(found)],
    )


def _refusal(stop: SystemExit, refusals: Refusals) -> str | None:
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
    reason = refusals[-1] if refusals and (named or str(error) == refusals[-1]) else str(error)
    return f"{option} {reason}" if named else reason
