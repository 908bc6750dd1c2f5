"""The command ``gva-mi prepare``: a video and a pose estimator's output, as a subject's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gva_mi.body.smplx import PUPPET_NAME
from gva_mi.commands.arguments import Switch
from gva_mi.console import bar, say
from gva_mi.data.importers.datasets import DATASETS
from gva_mi.data.importers.estimators import KINDS
from gva_mi.data.importers.prepare import MARKER, Source, prepare_folder
from gva_mi.data.importers.target import Target
from gva_mi.errors import InputError
from gva_mi.files import whole_folder
from gva_mi.ranges import Within


def prepare(
    kind: Positional[str],
    source: Positional[Path],
    out: Positional[Path],
    *,
    body: Path,
    frames: Path | None = None,
    masks: Path | None = None,
    person: str | None = None,
    first: Annotated[int, Within(0, 1_000_000_000)] = 0,
    focal: Annotated[float, Within(0, 1e6, "low", "pixels")] | None = None,
    camera: str | None = None,
    splits: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder of a video, masks, and what a pose estimator wrote; or a data set.

    Args:
        kind: of the estimator: wham, vibe, gvhmr, 4dhumans, glamr, pymafx, hybrik, tram, romp,
            multihmr, smplifyx, smplerx, parameters; or of the data set: snapshot, instantavatar,
            zju, easymocap, avatarrex, neuman; "auto" tells it by its keys and files.
        source: the estimator's file or folder, or the data set's folder of one subject; pickles
            run no code.
        out: the subject's folder.
        body: the body in SMPL-X's format that the poses are for, and that the other steps will be
            given; or the word puppet for the built-in one, which keeps rotations and no shape.
        frames: a film, or a folder of pictures; a data set has its own.
        masks: a film, a folder of pictures, a .npy (T, H, W), or a .hdf5 with masks; as many as
            frames; a data set has its own.
        person: the estimator's name of the person; without it, who is in the masks.
        first: the number that the estimator gave the first frame; SMPLer-X starts at 1.
        focal: focal length in pixels, where the estimator's file says none.
        camera: the name of a data set's camera; without it, the first.
        splits: a file of train and test ranges, such as InstantAvatar's confs/dataset/*.yaml.
        overwrite: replace a folder that was prepared here.
    """
    if kind != "auto" and kind not in (kinds := {**KINDS, **DATASETS}):
        raise InputError(f"prepare: kind must be auto, {', '.join(kinds)}; got {kind}")
    target = Target.read(body)
    if not overwrite and (out / MARKER).exists():
        raise InputError(f"{out}: was prepared already; give --overwrite to replace it")
    given = Source(kind, source, frames, masks, person, first, focal, camera, splits)
    with whole_folder(out, MARKER if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, given, target, progress)
    for note in notes:
        say(f"{source}: {note}")
    if target.name != PUPPET_NAME:
        say(f"{out}: the other steps expect --body {body}, too")
    say(f"subject: {out}")
