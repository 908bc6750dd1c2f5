"""The command ``gva-mi motion``: make poses that drive an avatar, of a motion file or a film."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.pose import save_poses
from gva_mi.cli.arguments import Flat, Switch, given, nth_person
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.data.importers.motions import Motion, MotionOptions, motion_of_poses, read_motion
from gva_mi.data.importers.track import TargetBody
from gva_mi.pose.film.prepare_film import FilmOptions, FilmSource, motion_of_film

FILMS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".gif")


def motion(
    source: Positional[Path],
    out: Positional[Path],
    options: Flat[MotionOptions] = MotionOptions(),  # noqa: B008 (frozen)
    film: Flat[FilmSource] = FilmSource(),  # noqa: B008 (frozen)
    *,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make poses of a motion of AMASS, AIST++, a pose estimator or the like, or of a film.

    Args:
        source: .bvh, .npz, .npy, .pkl or .pt, or an estimator's folder; pickles run no code. Or a
            film, whose largest person moves, or the --person of this number from the left.
        out: the poses, .npz.
        options: options of the conversion.
        film: of a film: what is known of it, and which part of it is used.
        lens: of a film: focal length, as 26mm of 35 mm film or in pixels; without it, what the film
            records, else a fitted one.
        body: the avatar's body, if it is not the built-in body: its pelvis stays in place when
            the world is turned upright.
        overwrite: replace an existing file.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out}: a file of poses ends in .npz")
    require_room(out, overwrite)
    target = TargetBody.read(body)
    of_film = [*given(film).values(), *(["--lens"] if lens else [])]
    if source.suffix.lower() in FILMS:
        known = FilmOptions(**vars(film))
        found = _of_film(source, known, lens, target, options)
    elif of_film:
        raise InputError(f"motion: {of_film[0]} is for films ({', '.join(FILMS)}); got {source}")
    else:
        found = read_motion(source, target, options)
    save_poses(out, found.pose, found.shape, stage=1)
    for note in found.notes:
        say(f"{source}: {note}")
    say(f"{len(found.pose)} poses: {out}")


def _of_film(
    film: Path, known: FilmOptions, lens: str | None, body: TargetBody, options: MotionOptions
) -> Motion:
    """Return the motion of one person in a film."""
    person = nth_person(options.person)
    with bar("motion") as progress:
        found = motion_of_film(film, known, body.model, person=person, lens=lens, progress=progress)
    solved, fps = found.solved, found.pictures.fps
    motion = motion_of_poses(str(film), solved.pose, solved.shape, fps, body, options)
    return replace(motion, notes=(*motion.notes, *found.notes))
