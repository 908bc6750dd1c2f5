"""The command ``gva-mi body``: write a body file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal

from gva_mi.body.anny import anny_body
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.cli.arguments import Switch
from gva_mi.core.atomic import atomic_write
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room


def body(
    *,
    source: Literal["puppet", "anny"] = "puppet",
    out: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write a body file in SMPL-X's format that needs no licence agreement.

    To convert poses of SMPL or SMPL+H, use gva-mi motion, or with a video gva-mi
    prepare parameters.

    Args:
        source: "puppet", the built-in body, or "anny", the free realistic body.
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
