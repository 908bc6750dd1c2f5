"""The command ``gva-mi export``: write an avatar or its poses for other programs and people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
from tyro.conf import Positional

from gva_mi.app.driving import motion_of
from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.export import NamedMotion, save_amass, save_gltf
from gva_mi.avatar.without_body import require_body_of, save_without_body
from gva_mi.body.pose import Pose
from gva_mi.body.rotations import to_matrices
from gva_mi.body.smplx import body_name, load_body
from gva_mi.cli.parse import Flat, Switch, given
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.core.options import Within, options_of
from gva_mi.evaluate.report import THE_VIDEO, driven_motions
from gva_mi.fit.run_folder import body_of_run, load_avatar, trained_poses
from gva_mi.fit.web_page import save_page
from gva_mi.readers.up_axis import LYING_DEGREES, Axis, Upward, turn_to_y
from gva_mi.splat.axes import rotated, with_axes
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.formats.spz import save_splat, save_spz
from gva_mi.splat.formats.stored import with_degree
from gva_mi.splat.gaussians import MAX_DEGREE

SAVE = {".ply": save_ply, ".splat": save_splat, ".spz": save_spz}  # files of Gaussians
FORMATS = {  # what each file holds, and the options that have an effect on it
    ".ply": ("Gaussians, for viewers of 3DGS", ("poses", "frame", "series", "sh_degree", "up")),
    ".splat": ("32 bytes each, for viewers in a browser", ("poses", "frame", "series", "up")),
    ".spz": ("Niantic's, a quarter of a .ply", ("poses", "frame", "series", "sh_degree")),
    ".glb": ("the surface with skeleton, skin, colours, and a motion", ("poses", "fps", "splats")),
    ".npz": (
        "poses in AMASS's format; with --no-rig the avatar without its body",
        ("poses", "fps", "no_rig"),
    ),
    ".html": ("a page that plays the avatar in any browser", ("poses", "fps", "no_rig")),
}


@options_of("export")
class ExportOptions:
    """Options of what ``export`` writes."""

    # Poses, or any motion that gva-mi motion reads; without it, the trained poses.
    poses: Path | None = None
    # Frame of the poses; without it and without --poses, Gaussians are in the rest pose.
    frame: Annotated[int, Within(0, 1_000_000)] | None = None
    # .ply, .splat, .spz: a file for each frame, such as walk0000.ply, which SuperSplat plays
    series: Switch = False
    fps: Annotated[int, Within(1, 1000)] = 30  # frames per second
    # Degree of the Gaussians' spherical harmonics, which are cut or padded with zeros; with 3, a
    # Gaussian takes 248 bytes in a .ply.
    sh_degree: Annotated[int, Within(0, MAX_DEGREE)] | None = None
    up: Axis = "-y"  # the file's axis that is up; in files of 3DGS it is -y
    # .glb: the Gaussians too, on the same skeleton, and all motions
    splats: Switch = False
    # .npz: the avatar without the data of a licensed body; .html: the page without the mesh
    no_rig: Switch = False


def export(
    run: Positional[Path],
    options: Flat[ExportOptions] = ExportOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write an avatar or its poses for other programs; gva-mi render makes videos.

    Args:
        run: the folder of a finished fit, or an avatar.npz.
        options: content of the file.
        out: the file, whose suffix chooses the format: .ply, .splat, .spz (Gaussians in one pose),
            .glb (the surface with skeleton and skin), .html (a page that plays the avatar), or .npz
            (poses in AMASS's format, or with --no-rig the avatar).
        body: the body file of an avatar without its body, or for --no-rig; without it, the built-in
            body.
        overwrite: replace an existing file.
    """
    _require_meant(out, out.suffix.lower(), options)
    require_room(out, overwrite)
    _write(run, out, options, body_of_run(run, body), overwrite)
    say(f"exported: {out.with_stem(f'{out.stem}NNNN') if options.series else out}")


def _require_meant(out: Path, suffix: str, options: ExportOptions) -> None:
    """Raise an InputError for an unknown format, and for options without an effect on it."""
    if suffix not in FORMATS:
        known = ", ".join(f"{name} ({what})" for name, (what, _) in FORMATS.items())
        raise InputError(
            f"{out}: no format ends in {suffix or out.name}; expected {known}; gva-mi render "
            "--video makes videos"
        )
    for name, option in given(options).items():
        meant = [kind for kind, (_, effective) in FORMATS.items() if name in effective]
        if suffix not in meant:
            *others, last = meant
            raise InputError(
                f"export: {option} is for {', '.join(others)} and {last}, not for {suffix}"
            )
    if suffix == ".npz" and options.no_rig and options.poses is not None:
        raise InputError("export: --no-rig writes the avatar, --poses its poses; not both")


@torch.no_grad()
def _write(
    run: Path, out: Path, options: ExportOptions, body: Path | None, overwrite: bool
) -> None:
    """Write an avatar, or the poses that drive it."""
    avatar, suffix = load_avatar(run, body), out.suffix.lower()
    if suffix == ".html":
        motions = _motions(run, avatar, options, body, every=True)
        save_page(out, avatar, motions, out.stem, surface=not options.no_rig)
    elif suffix == ".glb":
        motions = _motions(run, avatar, options, body, every=options.splats)
        save_gltf(out, avatar, motions, options.splats)
    elif options.no_rig:
        model, name = load_body(body), body_name(body)
        require_body_of(avatar, model, name)
        save_without_body(out, avatar, model, name)
    elif suffix == ".npz":
        save_amass(out, *motion_of(run, avatar, options.poses, options.fps, body), options.fps)
    else:
        motion = Pose.rest()
        if options.poses is not None or options.frame is not None or options.series:
            motion, _ = motion_of(run, avatar, options.poses, options.fps, body)
        _write_gaussians(out, avatar, motion, options, overwrite)


def _write_gaussians(
    out: Path, avatar: Avatar, motion: Pose, options: ExportOptions, overwrite: bool
) -> None:
    """Write the Gaussians of a frame, or of each in a file of its own."""
    first = options.frame or 0
    if first >= len(motion):
        raise InputError(f"export: --frame {first} is out of range; there are {len(motion)} poses")
    files = {out: first}
    if options.series:
        files = {out.with_stem(f"{out.stem}{k:04d}"): k for k in range(first, len(motion))}
    for file in files:
        require_room(file, overwrite)
    pose = motion[first]
    arrays = (x.double().numpy() for x in (pose.rotations, pose.transl, avatar.rig.joints))
    if Upward.of(*arrays, rate=1).lean("y") > LYING_DEGREES:
        say(f"{out}: doubtful: the person lies; expected poses in a world with y up")
    R = to_matrices(turn_to_y(options.up)).T
    for file, frame in files.items():
        gaussians = rotated(with_axes(avatar(motion[frame])), R)
        if options.sh_degree is not None:
            gaussians = with_degree(gaussians, options.sh_degree)
        SAVE[out.suffix.lower()](file, gaussians)


def _motions(
    run: Path, avatar: Avatar, options: ExportOptions, body: Path | None, every: bool
) -> list[NamedMotion]:
    """Return ``--poses``, and if ``every`` is true, other motions and the poses of the video."""
    play = lambda name, poses: NamedMotion(
        name, motion_of(run, avatar, poses, options.fps, body)[0], options.fps
    )
    given = [] if options.poses is None else [play(options.poses.stem, options.poses)]
    if not every:
        return given
    there = trained_poses(run if run.is_dir() else run.parent) is not None
    return [*given, *driven_motions(avatar), *([play(THE_VIDEO, None)] if there else [])]
