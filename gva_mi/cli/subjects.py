"""The commands ``synth`` and ``body``: a synthetic subject, and a body file without a licence."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from gva_mi.body.anny import anny_body
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.smplx import load_body
from gva_mi.cli.parse import Flat, Switch
from gva_mi.core.atomic import atomic_write, require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_replaceable, require_room
from gva_mi.core.tasks import usual_workers
from gva_mi.subject.folder import SYNTH
from gva_mi.synthetic import SynthOptions, make_subject


def synth(
    out: Positional[Path],
    options: Flat[SynthOptions] = SynthOptions(),  # noqa: B008 (frozen)
    *,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras, inaccurate poses, ground truth.

    Args:
        out: the subject's folder.
        options: options of the subject.
        body: a body file in SMPL-X's format (.npz); without it, the built-in body.
        overwrite: replace an existing subject.
    """
    model, options = load_body(body), replace(options, workers=usual_workers())
    require_replaceable(out, SYNTH, overwrite)
    require_writable(out.absolute().parent)
    with bar("synth") as progress:
        make_subject(out, options, model, progress, SYNTH if overwrite else None)
    say(f"subject: {out}")


def body(
    *,
    source: Literal["built-in", "anny"] = "built-in",
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write a body file in SMPL-X's format that needs no licence agreement.

    To convert poses of SMPL or SMPL+H, use gva-mi motion, or with a video gva-mi prepare
    parameters.

    Args:
        source: "built-in", the built-in body, or "anny", the free realistic body.
        out: the body file, .npz; without it, a file named after the source in the working folder.
        overwrite: replace an existing file.
    """
    out = Path(f"{source}.npz") if out is None else out
    if out.suffix != ".npz":
        raise InputError(f"{out}: a body file ends in .npz")
    require_room(out, overwrite)
    path = anny_body() if source == "anny" else BUILT_IN_BODY
    with atomic_write(out) as unfinished:
        shutil.copyfile(path, unfinished)
    say(str(out))
