"""The command ``gva-mi export``: write an avatar or its poses for other programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import torch
from tyro.conf import Positional

from gva_mi.app.driving import motion_of, series, stamp_of
from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.export import save_amass, save_gltf
from gva_mi.avatar.without_body import require_body_of, save_without_body
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import body_name, load_body
from gva_mi.cli.arguments import Flat, Switch, given
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_room
from gva_mi.core.options import Within, options_of
from gva_mi.data.folder import frame_name
from gva_mi.fit.run_folder import body_of_run, load_avatar
from gva_mi.splat import Gaussians
from gva_mi.splat.axes import half_turned, with_axes
from gva_mi.splat.formats import LOAD
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.formats.spz import save_splat, save_spz
from gva_mi.splat.formats.stored import finite_ones, with_degree
from gva_mi.splat.gaussians import MAX_DEGREE

MARKER = "export.json"  # every folder of exports holds it
SAVE = {".ply": save_ply, ".splat": save_splat, ".spz": save_spz}


@options_of("export")
class ExportOptions:
    """Options of what ``export`` writes."""

    # A motion: SMPL-X's names, or any that gva-mi motion reads; without it the trained poses.
    poses: Path | None = None
    # Frame of the poses; without it and --poses, Gaussians are in the rest pose.
    frame: Annotated[int, Within(0, 1_000_000)] | None = None
    # Into a folder: write one file for every n-th frame.
    every: Annotated[int, Within(1, 1_000_000)] = 1
    each: Literal["ply", "splat", "spz"] = "ply"  # kind of the files in a folder
    fps: Annotated[int, Within(1, 1000)] = 30  # frames a second
    # Of the harmonics of Gaussians: cut or filled up with zeros; 3 makes 248 bytes each in a .ply.
    sh_degree: Annotated[int, Within(0, MAX_DEGREE)] | None = None
    no_rig: Switch = False  # .npz: the avatar without the data of a licensed body


Work = Callable[[], None]  # writes to --out; everything it can fail on has been checked


@dataclass(frozen=True)
class _Export:
    """State of one call of the command: the avatar and its options."""

    run: Path
    avatar: Avatar
    options: ExportOptions
    out: Path
    body: Path | None
    overwrite: bool

    def driving(self) -> tuple[Pose, Shape]:
        """Return the poses that the options name, and the shape (betas) that belongs to them."""
        return motion_of(self.run, self.avatar, self.options.poses, self.options.fps, self.body)

    @torch.no_grad()
    def save(self, path: Path, pose: Pose) -> None:
        """Write the avatar's Gaussians in one pose, in the axes of files."""
        gaussians, degree = self.avatar(pose), self.options.sh_degree
        _save_gaussians(path, _suffix(path), gaussians, path, degree, in_world=True)


def export(
    run: Positional[Path],
    options: Flat[ExportOptions] = ExportOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write an avatar or its poses in a file of other programs. Films are made by render.

    If writing a folder was interrupted, the same command resumes it.

    Args:
        run: the folder of a finished fit, or an avatar.npz; or a .ply, a .splat or
            a .spz, which becomes another of these.
        options: content of the file.
        out: the file, whose suffix says what it is: .ply, .splat, .spz
            (Gaussians in one pose), .glb (the surface with skeleton and skin), .npz (poses as
            AMASS has them, or with --no-rig the avatar); or a folder for one file a frame.
        body: the body file of an avatar without its body, or for --no-rig; without it the built-in
            puppet.
        overwrite: replace what is there.
    """
    suffix = "" if out.is_dir() else _suffix(out)
    _require_meant(suffix, options)
    if run.suffix.lower() in LOAD and not run.is_dir():
        work = _converted(run, options, suffix, out)
    else:
        body = body_of_run(run, body)
        job = _Export(run, load_avatar(run, body), options, out, body, overwrite)
        work = FORMATS[suffix].prepare(job)
    if suffix:
        require_room(out, overwrite)
    work()
    say(f"exported: {out}")


def _suffix(out: Path) -> str:
    """Return the key of :data:`FORMATS` that a file name selects."""
    suffix = out.suffix.lower()
    if suffix not in FORMATS:
        there = ", ".join(f"{name} ({format.what})" for name, format in FORMATS.items() if name)
        raise InputError(
            f"{out}: no format ends in {suffix}; expected {there}, or {FORMATS[''].what}; "
            "gva-mi render --video makes films"
        )
    return suffix


def _require_meant(suffix: str, options: ExportOptions) -> None:
    """Raise an InputError for options that have no effect on the format."""
    kind = suffix or "a folder"
    for name, option in given(options).items():
        meant = [suffix or "a folder" for suffix, f in FORMATS.items() if name in f.options]
        if kind not in meant:
            raise InputError(f"export: {option} is for {' and '.join(meant)}, not for {kind}")


def _converted(source: Path, options: ExportOptions, suffix: str, out: Path) -> Work:
    """Prepare to write a file of Gaussians as another one."""
    if suffix not in SAVE or replace(options, sh_degree=None) != ExportOptions():
        raise InputError(
            f"{source}: holds Gaussians alone, which become {', '.join(SAVE)} as they are; "
            f"expected such a name and no other option than --sh-degree, got {out}"
        )
    gaussians = LOAD[source.suffix.lower()](source)
    return lambda: _save_gaussians(out, suffix, gaussians, source, options.sh_degree)


def _save_gaussians(
    path: Path,
    suffix: str,
    gaussians: Gaussians,
    source: Path,
    degree: int | None,
    in_world: bool = False,
) -> None:
    """Write Gaussians, without those that hold NaN or infinite numbers.

    Args:
        path: of the file.
        suffix: its kind, in :data:`SAVE`.
        gaussians: torch tensors, in the axes of files (:mod:`gva_mi.splat.axes`).
        source: of the Gaussians, for messages.
        degree: of their spherical harmonics; None: as they are.
        in_world: they are in the world's axes instead.
    """
    kept = finite_ones(source, gaussians)
    if len(kept) < len(gaussians):
        lost = len(gaussians) - len(kept)
        say(f"{path}: {lost} of {len(gaussians)} Gaussians hold NaN or infinite numbers: left out")
    if gaussians.antialiased and suffix != ".spz":
        say(f"{path}: {source} is to be drawn antialiased (Mip-Splatting), as only a .spz can say")
    kept = half_turned(with_axes(kept)) if in_world else kept
    SAVE[suffix](path, kept if degree is None else with_degree(kept, degree))


def _gaussians(job: _Export) -> Work:
    options, pose = job.options, Pose.rest()
    if options.poses is not None or options.frame is not None:
        (motion, _), frame = job.driving(), options.frame or 0
        if frame >= len(motion):
            raise InputError(f"export: frame {frame} is not there, the poses have {len(motion)}")
        pose = motion[frame]
    return lambda: job.save(job.out, pose)


def _surface(job: _Export) -> Work:
    motion = job.driving()[0] if job.options.poses else None
    return lambda: save_gltf(job.out, job.avatar, motion, job.options.fps)


def _poses(job: _Export) -> Work:
    if job.options.no_rig:
        if job.options.poses is not None:
            raise InputError("export: --no-rig writes the avatar, --poses its poses; not both")
        body, name = load_body(job.body), body_name(job.body)
        require_body_of(job.avatar, body, name)
        return lambda: save_without_body(job.out, job.avatar, body, name)
    motion, shape = job.driving()
    return lambda: save_amass(job.out, motion, shape, job.options.fps)


def _folder(job: _Export) -> Work:
    (motion, _), options = job.driving(), job.options
    frame_of = {frame_name(k, f".{options.each}"): k for k in range(0, len(motion), options.every)}
    form = options.each, options.every, str(options.sh_degree)
    made_of = stamp_of(job.avatar, motion, (), *form)
    about = {"avatar": str(job.run), "poses": options.poses}

    def work() -> None:
        names = series(job.out, MARKER, list(frame_of), job.overwrite, about, made_of)
        with names as missing, bar("export") as progress:
            for done, name in enumerate(missing, 1):
                job.save(job.out / name, motion[frame_of[name]])
                progress(done, len(missing))

    return work


class OutputFormat(NamedTuple):
    """Format that a suffix of ``--out`` selects."""

    what: str
    prepare: Callable[[_Export], Work]
    options: tuple[str, ...]  # names of the options that have an effect


_ONE_POSE = _gaussians, ("poses", "frame", "sh_degree")
FORMATS = {
    ".ply": OutputFormat("Gaussians in one pose, for viewers of 3DGS", *_ONE_POSE),
    ".splat": OutputFormat(
        "the same in 32 bytes each, for viewers in a browser", _gaussians, ("poses", "frame")
    ),
    ".spz": OutputFormat("Niantic's, a quarter of a .ply, with spherical harmonics", *_ONE_POSE),
    ".glb": OutputFormat(
        "the surface with skeleton, skin, colours, and a motion", _surface, ("poses", "fps")
    ),
    ".npz": OutputFormat(
        "poses as AMASS has them; with --no-rig the avatar without its body", _poses,
        ("poses", "fps", "no_rig"),
    ),
    "": OutputFormat("a folder with one file a frame", _folder,
                     ("poses", "every", "each", "sh_degree")),
}  # fmt: skip
