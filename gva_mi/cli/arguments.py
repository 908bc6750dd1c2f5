"""Arguments that several commands share, and how their files are opened."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import FlagCreatePairsOff, arg

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.data.fingerprint import prepared_body
from gva_mi.data.folder import POSES, REFINED_POSES
from gva_mi.data.silhouettes import sanity_check
from gva_mi.data.video import Video

MOST_PEOPLE = 20  # that --person tells apart

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line
Switch = Annotated[bool, FlagCreatePairsOff]  # off by default and without a --no-... form


def given(options: object, plain: object | None = None) -> dict[str, str]:
    """Return the fields that differ from ``plain``, or from the defaults, and their options."""
    usual = vars(type(options)() if plain is None else plain)
    differ = (name for name, value in vars(options).items() if value != usual[name])
    return {name: f"--{name.replace('_', '-')}" for name in differ}


def poses_of(subject: Path, given: Path | None = None) -> Path:
    """Return the file that ``--poses`` names; without it the refined poses, else stage 1's.

    Unrefined poses are no error, but a line mentions them.
    """
    refined = subject / REFINED_POSES
    if given is None and not refined.exists():
        say(f"{subject}: no {REFINED_POSES}, the stage-1 poses are used as they are")
        return subject / POSES
    return given or refined


def body_of(subject: Path, given: Path | None = None) -> Path | None:
    """Return the file that ``--body`` names; without it the one that a subject was prepared for.

    None is the built-in body.

    Raises:
        InputError: the file is gone.
    """
    found = given or prepared_body(subject)
    if given is None and found is not None and not found.exists():
        raise InputError(
            f"{subject}: was prepared for the body {found}, which is gone; give it with --body"
        )
    return found


def nth_person(text: str | None) -> int | None:
    """Return the person of a film that ``--person`` names, from the left; None: the largest."""
    if text is not None and not (text.isdecimal() and 1 <= int(text) <= MOST_PEOPLE):
        raise InputError(
            f"--person of a film must be a number from 1 to {MOST_PEOPLE}, from the left; "
            f"got {text}"
        )
    return None if text is None else int(text)


def warn_if_outside_masks(video: Video, model: BodyModel) -> None:
    """Warn if the body does not stand where the masks are, before the work starts."""
    if doubt := sanity_check(video, model):
        say(doubt)
