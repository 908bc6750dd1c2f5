"""The command ``gva-mi motion``: convert another program's motion to poses that drive an avatar."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.pose import save_poses
from gva_mi.cli.arguments import Flat, Switch
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.target import TargetBody


def motion(
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[MotionOptions] = MotionOptions(),  # noqa: B008 (frozen)
    *,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Convert a motion of AMASS, AIST++, a pose estimator, or the like into poses.

    Args:
        source: .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code.
        out: the poses, .npz.
        options: options of the conversion.
        body: the avatar's body, if it is not the built-in body: its pelvis stays in place when
            the world is turned upright, and hands that are components of a PCA are its own.
        overwrite: replace an existing file.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out}: a file of poses ends in .npz")
    require_room(out, overwrite)
    found = read_motion(source, TargetBody.read(body), options)
    save_poses(out, found.pose, found.shape, stage=1)
    for note in found.notes:
        say(f"{source}: {note}")
    say(f"{len(found.pose)} poses: {out}")
