"""The command ``gva-mi body``: write a body file and pictures of it."""

from __future__ import annotations

import shutil
from pathlib import Path

from gva_mi.body.anny import anny_body
from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Switch
from gva_mi.core.atomic import atomic_write
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.data.pictures import require_picture, write_image
from gva_mi.synthetic.portrait import pose_sheet as draw_sheet
from gva_mi.synthetic.portrait import turntable


def body(
    *,
    source: str = "puppet",
    out: Path | None = None,
    sheet: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write a body file and a picture that shows it from several sides.

    To convert poses of SMPL, SMPL+H or hand components, use gva-mi motion, or with a video gva-mi
    prepare parameters.

    Args:
        source: "puppet", the built-in body; "anny", the free realistic body; or a file of SMPL-X,
            SMPL+H or SMPL, .npz or .pkl.
        out: the body file, .npz, with the picture beside it as .png. Without it, only the picture
            is written, to the working folder, named after the source.
        sheet: also write a picture (.png) of poses, hands and faces.
        overwrite: replace existing files.
    """
    path = (
        BUILT_IN_BODY if source == "puppet" else anny_body() if source == "anny" else Path(source)
    )
    model = load_body(path)
    if out is not None and out.suffix != ".npz":
        raise InputError(f"{out}: a body file ends in .npz")
    if out is not None and path.suffix != ".npz":
        raise InputError(f"{path}: --out copies a file, expected one that is .npz already")
    picture = (out or Path(f"{path.stem}.npz")).with_suffix(".png")
    if out is not None:
        require_room(out, overwrite)
    for file in filter(None, (picture, sheet)):
        require_picture(file, overwrite)
    if out is not None and not (out.exists() and out.samefile(path)):
        with atomic_write(out) as unfinished:
            shutil.copyfile(path, unfinished)
    write_image(picture, turntable(model))
    if sheet is not None:
        write_image(sheet, draw_sheet(model))
    for file in filter(None, (out, picture, sheet)):
        say(str(file))
