"""The command ``gva-mi prepare``: a film, or a video and an estimator's output, as a subject."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gva_mi import app
from gva_mi.cli.arguments import Flat, Switch, given, nth_person
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.data.fingerprint import FILM, PREPARED
from gva_mi.data.importers.datasets import DATASETS
from gva_mi.data.importers.estimators import KINDS
from gva_mi.data.importers.prepare import PrepareOptions, prepare_folder
from gva_mi.data.importers.track import TargetBody
from gva_mi.pose.film.prepare_film import FilmOptions

OF_FILMS = ("body", "person", "lens", "masks")  # of PrepareOptions
_HELP = (
    f"{FILM}, of which everything is estimated here; or the estimator: {', '.join(KINDS)}; or the "
    f"data set: {', '.join(DATASETS)}; "
    '"auto" recognises it by its keys and files'
)


def prepare(
    kind: Annotated[Positional[str], arg(help=_HELP)],
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[PrepareOptions] = PrepareOptions(),  # noqa: B008 (frozen)
    film: Flat[FilmOptions] = FilmOptions(),  # noqa: B008 (frozen)
    *,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder of a film; of a video, masks and an estimator's file; or a data set.

    Args:
        kind: kind of the source.
        source: the film, or a folder of its pictures; the estimator's file or folder; or the data
            set's folder of one subject; pickles run no code.
        out: the subject's folder.
        options: pictures, masks, lens and body that belong to the source.
        film: of a film.
        overwrite: replace a folder that was prepared here.
    """
    if kind not in ("auto", FILM) and kind not in (kinds := {**KINDS, **DATASETS}):
        raise InputError(f"prepare: kind must be auto, {FILM}, {', '.join(kinds)}; got {kind}")
    if kind == FILM:
        wrong = [option for name, option in given(options).items() if name not in OF_FILMS]
        if wrong:
            raise InputError(f"prepare: {wrong[0]} is not for a {FILM}")
        app.prepare(
            source, out, film, options, person=nth_person(options.person), lens=options.lens,
            body=options.body, overwrite=overwrite,
        )  # fmt: skip
        return
    if wrong := given(film):
        raise InputError(f"prepare: {next(iter(wrong.values()))} is for a {FILM}; got {kind}")
    if options.body is None:
        raise InputError("prepare: give --body, the body of the poses; puppet is the built-in one")
    body = TargetBody.read(options.body)
    if not overwrite and (out / PREPARED).exists():
        raise InputError(f"{out}: was prepared already; give --overwrite to replace it")
    with atomic_dir(out, PREPARED if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, kind, source, options, body, progress)
    for note in notes:
        say(f"{source}: {note}")
    say(f"subject: {out}")
