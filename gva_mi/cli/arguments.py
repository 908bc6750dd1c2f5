"""Arguments that several commands share."""

from __future__ import annotations

from typing import Annotated, TypeVar

from tyro.conf import FlagCreatePairsOff, arg

from gva_mi.core.errors import InputError

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
