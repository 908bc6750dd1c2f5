"""The command ``gva-mi export``: an avatar, its poses, or a film of it, for other programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import torch
from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.formats.amass import save_amass
from gva_mi.avatar.formats.gltf import save_gltf
from gva_mi.avatar.formats.without_body import require_body_of, save_without_body
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import body_name, load_body
from gva_mi.commands.arguments import Flat, Switch
from gva_mi.commands.driving import motion_of
from gva_mi.commands.series import HASH, hash_of, series
from gva_mi.console import bar, say
from gva_mi.data.pictures import (
    SEE_THROUGH,
    read_background,
    require_see_through,
    write_image,
    write_movie,
    write_see_through,
)
from gva_mi.errors import InputError
from gva_mi.files import require_room
from gva_mi.fit.camera_paths import CameraPath, Shot, shots
from gva_mi.fit.renders import over, render_shots, see_through
from gva_mi.fit.run_folder import load_avatar
from gva_mi.ranges import Within, require_ranges
from gva_mi.splat import Gaussians
from gva_mi.splat.formats import LOAD
from gva_mi.splat.formats.compressed_ply_writer import save_compressed_ply
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.formats.splat import save_splat
from gva_mi.splat.formats.spz import save_spz

MARKER = "export.json"  # every folder of exports that was made here holds it
COMPRESSED = ".compressed.ply"  # the name's end by which SuperSplat knows them, too
FORMATS = {  # by the suffix of --out
    ".ply": "Gaussians in one pose, for viewers of 3DGS",
    COMPRESSED: "the same in 16 bytes each, as SuperSplat writes it",
    ".splat": "the same in 32 bytes each, for viewers in a browser",
    ".spz": "Niantic's, a quarter of a .ply, with spherical harmonics",
    ".glb": "the surface with skeleton, skin, colours, and a motion",
    ".npz": "poses as AMASS has them; with --no-rig the avatar without its body",
    ".mp4": "a film",
    SEE_THROUGH: "a see-through film",
    "": "a folder with one file a frame",
}
SAVE = {
    ".ply": save_ply, COMPRESSED: save_compressed_ply, ".splat": save_splat, ".spz": save_spz,
}  # fmt: skip
FILMS = (".mp4", SEE_THROUGH)
FOR = {  # what the options are about; the others are about all
    "frame": (*SAVE, *FILMS),
    "every": ("",),
    "each": ("",),
    "fps": (".glb", ".npz", *FILMS),
    "background": (".mp4",),
    "no_rig": (".npz",),
}


@dataclass(frozen=True)
class ExportOptions:
    """What of an avatar is written."""

    # A motion: SMPL-X's names, or whatever gva-mi motion reads; none: those trained with it.
    poses: Path | None = None
    # Of the poses; Gaussians without it and --poses are at rest.
    frame: Annotated[int, Within(0, 1_000_000)] | None = None
    # Into a folder: one file for every so many frames.
    every: Annotated[int, Within(1, 1_000_000)] = 1
    # Kind of these files; .png are see-through.
    each: Literal["ply", "compressed.ply", "splat", "spz", "png"] = "ply"
    fps: Annotated[int, Within(1, 1000)] = 30  # frames a second
    background: str = "white"  # of a film: a colour, such as #ff8800, or a picture file
    no_rig: Switch = False  # .npz: the avatar, without what it holds of a licensed body

    def __post_init__(self) -> None:
        require_ranges("export", self)


@dataclass(frozen=True)
class _Job:
    """One call of the command, its avatar read."""

    run: Path
    avatar: Avatar
    options: ExportOptions
    view: CameraPath
    out: Path
    body: Path | None
    overwrite: bool

    def driving(self) -> tuple[Pose, Shape]:
        """The poses that were asked for, and whose they are."""
        options = self.options
        return motion_of(self.run, self.avatar, options.poses, options.fps, self.body)

    def motion(self) -> Pose:
        """The poses that were asked for, in which there is the frame that was."""
        motion, _ = self.driving()
        if (self.options.frame or 0) >= len(motion):
            frame = self.options.frame
            raise InputError(f"export: frame {frame} is not there, the poses have {len(motion)}")
        return motion

    def shots(self, motion: Pose) -> list[Shot]:
        """The pictures of a film."""
        view = self.view.or_usual(moving=self.options.poses is not None)
        return shots(view, self.avatar.rig, motion, self.options.frame or 0)


Work = Callable[[], None]  # writes to a job's --out; all that it can fail on has been checked


def export(
    run: Positional[Path],
    options: Flat[ExportOptions] = ExportOptions(),  # noqa: B008 (frozen)
    view: Flat[CameraPath] = CameraPath(),  # noqa: B008 (frozen)
    *,
    out: Path,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Write an avatar, its poses, or a film of it in a file of other programs.

    Where a folder's was cut short, the same command goes on with it.

    Args:
        run: the folder of a finished fit, or an avatar.npz; or a .ply, also a compressed one, a
            .splat or a .spz, which becomes another of these.
        options: what is written.
        view: of films and .png.
        out: the file, whose suffix says what it is: .ply, .compressed.ply (SuperSplat's), .splat,
            .spz (Gaussians in one pose), .glb (the surface with skeleton and skin), .npz (poses as
            AMASS has them, or with --no-rig the avatar), .mp4 (a film), .webm (a see-through one);
            or a folder for one file a frame.
        body: the body file of an avatar without its body, or for --no-rig; without it the built-in
            puppet.
        overwrite: replace what is there.
    """
    suffix = _suffix(out)
    _require_meant(suffix, options, view)
    if run.suffix in LOAD and not run.is_dir():
        work = _converted(run, options, suffix, out)
    else:
        avatar = load_avatar(run, body)
        work = _READY[suffix](_Job(run, avatar, options, view, out, body, overwrite))
    if suffix:
        require_room(out, overwrite)
    work()
    say(f"exported: {out}")


def _suffix(out: Path) -> str:
    """The one of :data:`FORMATS` that is asked for."""
    suffix = "" if out.is_dir() else out.suffix.lower()
    suffix = COMPRESSED if suffix and out.name.lower().endswith(COMPRESSED) else suffix
    if suffix not in FORMATS:
        there = ", ".join(f"{name} ({what})" for name, what in FORMATS.items() if name)
        raise InputError(f"{out}: no format ends in {suffix}; expected {there}, or {FORMATS['']}")
    return suffix


def _require_meant(suffix: str, options: ExportOptions, view: CameraPath) -> None:
    """Refuse options that say nothing about the format."""
    kind = suffix or "a folder"
    for field in fields(options):
        of = FOR.get(field.name, (suffix,))
        if getattr(options, field.name) != field.default and suffix not in of:
            name, meant = field.name.replace("_", "-"), " and ".join(x or "a folder" for x in of)
            raise InputError(f"export: --{name} is for {meant}, not for {kind}")
    pictures = suffix in FILMS or (not suffix and options.each == "png")
    if view != CameraPath() and not pictures:
        raise InputError(f"export: cameras are for .mp4, .webm and --each png, not for {kind}")


def _converted(source: Path, options: ExportOptions, suffix: str, out: Path) -> Work:
    if suffix not in SAVE or options != ExportOptions():
        raise InputError(
            f"{source}: holds Gaussians alone, which become {', '.join(SAVE)} as they are; "
            f"expected such a name without other options, got {out}"
        )
    gaussians = LOAD[source.suffix](source)
    return lambda: SAVE[suffix](out, gaussians)


def _gaussians(job: _Job) -> Work:
    options = job.options
    at_rest = options.poses is None and options.frame is None
    pose = Pose.rest() if at_rest else job.motion()[options.frame or 0]
    return lambda: SAVE[_suffix(job.out)](job.out, _posed(job.avatar, pose))


def _surface(job: _Job) -> Work:
    motion = job.motion() if job.options.poses else None
    return lambda: save_gltf(job.out, job.avatar, motion, job.options.fps)


def _poses(job: _Job) -> Work:
    if job.options.no_rig:
        if job.options.poses is not None:
            raise InputError("export: --no-rig writes the avatar, --poses its poses; not both")
        body, name = load_body(job.body), body_name(job.body)
        require_body_of(job.avatar, body, name)
        return lambda: save_without_body(job.out, job.avatar, body, name)
    motion, shape = job.driving()
    return lambda: save_amass(job.out, motion, shape, job.options.fps)


def _film(job: _Job) -> Work:
    motion = job.motion()
    background = read_background(job.options.background, *job.view.size)
    pictures = job.shots(motion)

    def work() -> None:
        with bar("render") as progress:
            layers = render_shots(job.avatar, motion, pictures, progress)
            images = (over(layer, background) for layer in layers)
            write_movie(job.out, images, fps=job.options.fps, lossless=False)

    return work


def _see_through_film(job: _Job) -> Work:
    motion = job.motion()
    pictures = job.shots(motion)
    require_see_through(job.out)

    def work() -> None:
        with bar("render") as progress:
            layers = render_shots(job.avatar, motion, pictures, progress)
            write_see_through(job.out, map(see_through, layers), fps=job.options.fps)

    return work


def _folder(job: _Job) -> Work:
    motion, options = job.motion(), job.options
    pictures = job.shots(motion) if options.each == "png" else []
    of_file = {
        f"{k:06d}.{options.each}": k for k in range(0, len(pictures or motion), options.every)
    }
    made_of = hash_of(job.avatar, motion, pictures, (options.each, options.every))
    about = {"avatar": str(job.run), "poses": options.poses, HASH: made_of}

    def work() -> None:
        with (
            series(job.out, MARKER, list(of_file), job.overwrite, about) as missing,
            bar("export") as progress,
        ):
            if options.each == "png":
                taken = [pictures[of_file[name]] for name in missing]
                layers = render_shots(job.avatar, motion, taken, progress)
                for name, layer in zip(missing, layers, strict=True):
                    write_image(job.out / name, see_through(layer))
                return
            for done, name in enumerate(missing, 1):
                path = job.out / name
                SAVE[f".{options.each}"](path, _posed(job.avatar, motion[of_file[name]]))
                progress(done, len(missing))

    return work


_READY: dict[str, Callable[[_Job], Work]] = {
    ".ply": _gaussians,
    COMPRESSED: _gaussians,
    ".splat": _gaussians,
    ".spz": _gaussians,
    ".glb": _surface,
    ".npz": _poses,
    ".mp4": _film,
    SEE_THROUGH: _see_through_film,
    "": _folder,
}


@torch.no_grad()
def _posed(avatar: Avatar, pose: Pose) -> Gaussians:
    """The Gaussians of one pose."""
    return avatar(pose)
