"""``PrepareOptions``: the options of ``gva-mi prepare``, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

from gva_mi.core.errors import InputError
from gva_mi.core.options import Within, options_of
from gva_mi.data.networks.normals import NormalNetwork, NormalsSpec
from gva_mi.data.networks.segment_anything import GET, SegmentAnything
from gva_mi.data.normals import Convention

SAM = Path("sam")  # in the place of masks
Side = Annotated[int, Within(1, 8192, unit="pixels")]  # of what a network of normals is shown
Colour = Annotated[float, Within(-1000, 1000)]  # some take values up to 255
Spread = Annotated[float, Within(0, 1000, "low")]


@options_of("prepare")
class MaskOptions:
    """Masks that come from another program."""

    # Masks of the person: a film, a folder of pictures, or a .npy (T, H, W), one for each frame.
    # Or the word sam, with --sam-checkpoint. A film and a data set have masks without it.
    masks: Path | None = None
    sam_checkpoint: Path | None = None  # folder of Segment Anything or SAM 2, which makes the masks

    def __post_init__(self) -> None:
        if self.masks == SAM and self.sam_checkpoint is None and not SAM.exists():
            raise InputError(f"--masks sam needs --sam-checkpoint; expected {GET}")
        if self.sam_checkpoint is not None and self.masks != SAM:
            raise InputError("--sam-checkpoint makes masks, so it needs --masks sam")

    def mask_network(self) -> SegmentAnything | None:
        """Return the network that makes the masks, read before any work is done."""
        return SegmentAnything.load(self.sam_checkpoint) if self.sam_checkpoint else None


@options_of("prepare")
class PrepareOptions(MaskOptions):
    """Options of ``prepare`` beside the source."""

    # The body of the poses and of all later steps, in SMPL-X's format; or the word puppet for the
    # built-in one, which keeps rotations and no shape, and is a film's default.
    body: Path | None = None
    frames: Path | None = None  # a film, or a folder of pictures; a data set has its own
    # The estimator's name of the person; without it, chosen by the masks. In a film the number from
    # the left; without it, the largest.
    person: str | None = None
    # A file or folder of a hand estimator, such as HaMeR or WiLoR, whose hands take the place of
    # the source's.
    hands: Path | None = None
    # What rotations of its fingers are relative to: the flat hand, or MANO's mean hand.
    hands_zero: Literal["flat", "mean"] = "flat"
    wrists: Literal["body", "hands"] = "body"  # whose wrists are taken
    # The number that the estimator gave the first frame; without it, inferred from the program, the
    # pictures' names, and the count.
    first: Annotated[int, Within(0, 1_000_000_000)] | None = None
    # Focal length in pixels, for an estimator's file without one.
    focal: Annotated[float, Within(1, 1e6, unit="pixels")] | None = None
    # True focal length, if the estimator assumed another: in pixels; of 35 mm film, such as 26mm;
    # or recorded, the value in the video's file. The person moves so that the picture stays the
    # same.
    lens: str | None = None
    camera: str | None = None  # the name of a data set's camera; without it, the first
    # Names of a data set's other cameras, whose pictures are held out as novel views for evaluate;
    # or all.
    views: tuple[str, ...] = ()
    # Frames that each of these cameras contributes, evenly spaced.
    view_frames: Annotated[int, Within(1, 100_000)] = 8
    # A folder of maps, one per frame by the last number in its name; or a network, .onnx, that
    # takes pictures (1, 3, h, w), and perhaps normals of the posed body, as ICON's does.
    normals: Path | None = None
    # Axes and view of the maps, or of the network's output; icon: a square crop.
    normals_convention: Convention | None = None
    # Width and height of the network's input, if its file does not say.
    normals_size: tuple[Side, Side] = NormalsSpec.size
    normals_mean: tuple[Colour, Colour, Colour] = NormalsSpec.mean  # subtracted from rgb in [0, 1]
    normals_std: tuple[Spread, Spread, Spread] = NormalsSpec.std  # divisor after the subtraction
    normals_output: str | None = NormalsSpec.output  # the network's output, if it has several

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hands is None and (self.hands_zero, self.wrists) != ("flat", "body"):
            raise InputError("prepare: --hands-zero and --wrists need --hands")
        if self.normals is not None and self.normals_convention is None:
            raise InputError(
                "prepare: --normals needs --normals-convention, what its normals mean: "
                f"{', '.join(get_args(Convention))}"
            )
        for name in ("size", "mean", "std", "output") if self.has_maps else ():
            if getattr(self, f"normals_{name}") != getattr(NormalsSpec, name):
                raise InputError(
                    f"prepare: --normals-{name} is for a network, and {self.normals} is a folder"
                )

    @property
    def has_maps(self) -> bool:
        """Whether the normals are maps in a folder, and not a network."""
        return self.normals is not None and self.normals.is_dir()

    def normal_network(self) -> NormalNetwork | None:
        """Return the network that makes the normals, read before any work is done."""
        if self.normals is None or self.has_maps:
            return None
        spec = NormalsSpec(
            self.normals_convention, self.normals_size, self.normals_mean, self.normals_std,
            self.normals_output,
        )  # fmt: skip
        return NormalNetwork(self.normals, spec)
