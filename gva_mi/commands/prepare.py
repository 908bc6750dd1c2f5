"""The command ``gva-mi prepare``: a video and a pose estimator's output, as a subject's folder."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.smplx import PUPPET_NAME
from gva_mi.commands.arguments import Switch
from gva_mi.console import bar, say
from gva_mi.data.importers.estimators import KINDS
from gva_mi.data.importers.prepare import MARKER, Source, prepare_folder
from gva_mi.data.importers.target import Target
from gva_mi.errors import InputError
from gva_mi.files import whole_folder


def prepare(
    kind: Positional[str],
    source: Positional[Path],
    out: Positional[Path],
    *,
    frames: Path,
    masks: Path,
    body: Path,
    person: str | None = None,
    first: int = 0,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder of a video, masks, and what a pose estimator wrote.

    Args:
        kind: of the estimator: wham, gvhmr, 4dhumans, smplerx; "auto" tells it by its keys.
        source: the estimator's file or folder; pickles run no code.
        out: the subject's folder.
        frames: a film, or a folder of pictures.
        masks: a film, a folder of pictures, or a .npy (T, H, W); as many as frames.
        body: the body in SMPL-X's format that the poses are for, and that the other steps will be
            given; or the word puppet for the built-in one, which keeps rotations and no shape.
        person: the estimator's name of the person; without it, who is in the masks.
        first: the number that the estimator gave the first frame; SMPLer-X starts at 1.
        overwrite: replace a folder that was prepared here.
    """
    if kind != "auto" and kind not in KINDS:
        raise InputError(f"prepare: kind must be auto, {', '.join(KINDS)}; got {kind}")
    target = Target.read(body)
    if not overwrite and (out / MARKER).exists():
        raise InputError(f"{out}: was prepared already; give --overwrite to replace it")
    given = Source(kind, source, frames, masks, person, first)
    with whole_folder(out, MARKER if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, given, target, progress)
    for note in notes:
        say(f"{source}: {note}")
    if target.name != PUPPET_NAME:
        say(f"{out}: the other steps expect --body {body}, too")
    say(f"subject: {out}")
