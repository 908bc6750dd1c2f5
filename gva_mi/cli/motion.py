"""The command ``gva-mi motion``: make poses that drive an avatar, of a motion file or a film."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gva_mi.body.pose import save_poses
from gva_mi.cli.arguments import Flat, Switch, nth_person
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.data.importers.motions import Motion, MotionOptions, motion_of_poses, read_motion
from gva_mi.data.importers.target import TargetBody
from gva_mi.pose.film.prepare_film import FilmOptions, motion_of_film
from gva_mi.pose.film.solver import CAMERA_HEIGHTS
from gva_mi.pose.stature import PERSON_HEIGHTS

FILMS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".gif")


def motion(
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[MotionOptions] = MotionOptions(),  # noqa: B008 (frozen)
    *,
    height: Annotated[float, PERSON_HEIGHTS] | None = None,
    camera_height: Annotated[float, CAMERA_HEIGHTS] | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make poses of a motion of AMASS, AIST++, a pose estimator or the like, or of a film.

    Args:
        source: .bvh, .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code. Or a
            film, whose largest person moves, or the --person of this number from the left.
        out: the poses, .npz.
        options: options of the conversion.
        height: of a film's person, metres; without it an average one, so that steps may be too
            long or too short.
        camera_height: of the lens of a film above the floor, metres: it shows how far the camera
            looks down.
        body: the avatar's body, if it is not the built-in body: its pelvis stays in place when
            the world is turned upright, and hands that are components of a PCA are its own.
        overwrite: replace an existing file.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out}: a file of poses ends in .npz")
    require_room(out, overwrite)
    target = TargetBody.read(body)
    if source.suffix.lower() in FILMS:
        film = FilmOptions(height=height, camera_height=camera_height)
        found = _of_film(source, film, target, options)
    elif given := [n for n, x in (("height", height), ("camera-height", camera_height)) if x]:
        raise InputError(f"motion: --{given[0]} is for films ({', '.join(FILMS)}); got {source}")
    else:
        found = read_motion(source, target, options)
    save_poses(out, found.pose, found.shape, stage=1)
    for note in found.notes:
        say(f"{source}: {note}")
    say(f"{len(found.pose)} poses: {out}")


def _of_film(film: Path, known: FilmOptions, body: TargetBody, options: MotionOptions) -> Motion:
    """Return the motion of one person in a film."""
    with bar("motion") as progress:
        found = motion_of_film(
            film, known, body.model, person=nth_person(options.person), progress=progress,
        )  # fmt: skip
    solved, fps = found.solved, found.pictures.fps
    motion = motion_of_poses(str(film), solved.pose, solved.shape, fps, body, options)
    return replace(motion, notes=(*motion.notes, *found.notes))
