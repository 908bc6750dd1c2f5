"""The command ``gva-mi prepare``: a video and a pose estimator's output, as a subject's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from gva_mi.cli.arguments import Flat, Switch
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.data.fingerprint import PREPARED
from gva_mi.data.importers.datasets import DATASETS
from gva_mi.data.importers.estimators import KINDS
from gva_mi.data.importers.prepare import prepare_folder
from gva_mi.data.importers.prepare_options import PrepareOptions
from gva_mi.data.importers.target import TargetBody

_HELP = (
    f"of the estimator: {', '.join(KINDS)}; or of the data set: {', '.join(DATASETS)}; "
    '"auto" recognises it by its keys and files'
)


def prepare(
    kind: Annotated[Positional[str], arg(help=_HELP)],
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[PrepareOptions],
    *,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder of a video, masks, and what a pose estimator wrote; or a data set.

    Args:
        kind: kind of the source.
        source: the estimator's file or folder, or the data set's folder of one subject; pickles
            run no code.
        out: the subject's folder.
        options: pictures, masks, lens and body that belong to the source.
        overwrite: replace a folder that was prepared here.
    """
    if kind != "auto" and kind not in (kinds := {**KINDS, **DATASETS}):
        raise InputError(f"prepare: kind must be auto, {', '.join(kinds)}; got {kind}")
    body = TargetBody.read(options.body)
    if not overwrite and (out / PREPARED).exists():
        raise InputError(f"{out}: was prepared already; give --overwrite to replace it")
    with atomic_dir(out, PREPARED if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, kind, source, options, body, progress)
    for note in notes:
        say(f"{source}: {note}")
    say(f"subject: {out}")
