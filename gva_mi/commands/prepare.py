"""The command ``gva-mi prepare``: a video and a pose estimator's output, as a subject's folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from tyro.conf import Positional

from gva_mi.body.smplx import PUPPET_NAME
from gva_mi.commands.arguments import Flat, Switch
from gva_mi.console import bar, say
from gva_mi.data.importers.datasets import DATASETS
from gva_mi.data.importers.estimators import KINDS
from gva_mi.data.importers.prepare import MARKER, Source, prepare_folder
from gva_mi.data.importers.target import Target
from gva_mi.data.networks.normals import Expected
from gva_mi.data.networks.sam_weights import GET
from gva_mi.data.normals import Convention
from gva_mi.errors import InputError
from gva_mi.files import whole_folder
from gva_mi.ranges import Within, require_ranges

SAM = Path("sam")  # in the place of masks
Side = Annotated[int, Within(1, 8192, unit="pixels")]  # of what a network of normals is shown
Colour = Annotated[float, Within(-1000, 1000)]  # some take values up to 255
Spread = Annotated[float, Within(0, 1000, "low")]


@dataclass(frozen=True)
class NetworkOptions:
    """Networks that people bring, and what they expect; or normals that another program made.

    Segment Anything makes the masks, told by the poses where the person is. A network of normals
    takes (1, 3, h, w) and answers likewise; conventions are those of :mod:`gva_mi.data.normals`.
    """

    sam_checkpoint: Path | None = None  # of Segment Anything or SAM 2: a folder, or Meta's .pth
    # A folder of maps, one a frame by the last number in its name; or a network: .pt (TorchScript,
    # a program that will run) or .onnx.
    normals: Path | None = None
    # Axes and view of the maps, or of the network's answer; icon: cut out.
    normals_convention: Convention | None = None
    # Pixels it is shown, if an .onnx does not say.
    normals_size: tuple[Side, Side] = Expected.size
    normals_mean: tuple[Colour, Colour, Colour] = Expected.mean  # rgb in [0, 1], taken off them
    # Likewise, what that is divided by.
    normals_std: tuple[Spread, Spread, Spread] = Expected.std

    def __post_init__(self) -> None:
        if self.normals is not None and self.normals_convention is None:
            raise InputError(
                "prepare: --normals needs --normals-convention, what its normals mean: "
                f"{', '.join(get_args(Convention))}"
            )
        if self.normals is not None and self.normals.is_dir():
            for name in ("size", "mean", "std"):
                if getattr(self, f"normals_{name}") != getattr(Expected, name):
                    raise InputError(
                        f"prepare: --normals-{name} is for a network, and {self.normals} is a "
                        "folder"
                    )
        require_ranges("prepare", self)

    @property
    def expected(self) -> Expected | None:
        """What the network of normals is given, and means; None without one."""
        if self.normals_convention is None:
            return None
        what = self.normals_size, self.normals_mean, self.normals_std
        return Expected(self.normals_convention, *what)


def prepare(
    kind: Positional[str],
    source: Positional[Path],
    out: Positional[Path],
    networks: Flat[NetworkOptions] = NetworkOptions(),  # noqa: B008 (frozen)
    *,
    body: Path,
    frames: Path | None = None,
    masks: Path | None = None,
    person: str | None = None,
    first: Annotated[int, Within(0, 1_000_000_000)] = 0,
    focal: Annotated[float, Within(0, 1e6, "low", "pixels")] | None = None,
    lens: str | None = None,
    camera: str | None = None,
    views: tuple[str, ...] = (),
    view_frames: Annotated[int, Within(1, 100_000)] = 8,
    splits: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a subject's folder of a video, masks, and what a pose estimator wrote; or a data set.

    Args:
        kind: of the estimator: wham, vibe, gvhmr, 4dhumans, glamr, pymafx, hybrik, tram, romp,
            multihmr, smplifyx, smplerx, osx, parameters; or of the data set: snapshot,
            instantavatar, zju, easymocap, avatarrex, neuman, exavatar; "auto" tells it by its
            keys and files.
        source: the estimator's file or folder, or the data set's folder of one subject; pickles
            run no code.
        out: the subject's folder.
        networks: that make masks and normals.
        body: the body in SMPL-X's format that the poses are for, and that the other steps will be
            given; or the word puppet for the built-in one, which keeps rotations and no shape.
        frames: a film, or a folder of pictures; a data set has its own.
        masks: a film, a folder of pictures, a .npy (T, H, W), or a .hdf5 with masks; as many as
            frames; a data set has its own. Or the word sam, with --sam-checkpoint.
        person: the estimator's name of the person; without it, who is in the masks.
        first: the number that the estimator gave the first frame; SMPLer-X starts at 1.
        focal: focal length in pixels, where the estimator's file says none.
        lens: focal length that it was filmed with, where the estimator assumed another: in pixels,
            as of 35 mm film, such as 26mm, or recorded, what the file of the video says; the person
            moves to where the picture stays the same.
        camera: the name of a data set's camera; without it, the first.
        views: names of a data set's other cameras, whose pictures are held out as novel views for
            evaluate; or all.
        view_frames: of the video, by each of these cameras, evenly spaced.
        splits: a file of train and test ranges, such as InstantAvatar's confs/dataset/*.yaml.
        overwrite: replace a folder that was prepared here.
    """
    if kind != "auto" and kind not in (kinds := {**KINDS, **DATASETS}):
        raise InputError(f"prepare: kind must be auto, {', '.join(kinds)}; got {kind}")
    sam = _sam_of(masks, networks.sam_checkpoint)
    target = Target.read(body)
    if not overwrite and (out / MARKER).exists():
        raise InputError(f"{out}: was prepared already; give --overwrite to replace it")
    given = Source(
        kind=kind, estimate=source, frames=frames, masks=None if sam else masks, sam=sam,
        normals=networks.normals, expected=networks.expected, person=person, first=first,
        focal=focal, lens=lens, camera=camera, views=views, view_frames=view_frames, ranges=splits,
    )  # fmt: skip
    with whole_folder(out, MARKER if overwrite else None) as folder, bar("prepare") as progress:
        notes = prepare_folder(folder, given, target, progress)
    for note in notes:
        say(f"{source}: {note}")
    if target.name != PUPPET_NAME:
        say(f"{out}: the other steps expect --body {body}, too")
    say(f"subject: {out}")


def _sam_of(masks: Path | None, checkpoint: Path | None) -> Path | None:
    """The weights that make the masks; None where these are given."""
    if masks == SAM and checkpoint is None and not SAM.exists():
        raise InputError(f"prepare: --masks sam needs --sam-checkpoint; expected {GET}")
    if checkpoint is not None and masks != SAM:
        raise InputError("prepare: --sam-checkpoint makes masks, so it needs --masks sam")
    return checkpoint
