"""The estimates of a pipeline for a recording: poses, camera, masks and normals with errors.

They depend on the ground truth and the options alone, so a recording can be degraded again (see
``provenance``). Masks and normals are degraded from the 8-bit files of the ground truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.data.folder import MASKS, NORMALS, TRUTH, SubjectWriter, frame_name
from gva_mi.data.normals import Convention, NormalMaps, in_convention
from gva_mi.data.pictures import read_image
from gva_mi.splat import Camera
from gva_mi.synthetic.closest import Closest
from gva_mi.synthetic.error_models.masks import Confusion, confusions, noisy_mask
from gva_mi.synthetic.error_models.models import EXACT, ErrorParameters, draw_errors
from gva_mi.synthetic.error_models.normals import noisy_normals
from gva_mi.synthetic.error_models.poses import estimated_camera, noisy_poses
from gva_mi.synthetic.error_models.processes import runs
from gva_mi.synthetic.options import MISSING, MISTAKEN, MOTION, NOISE, RENDER, SynthOptions

MISSING_FRAMES = 3.0  # mean number of consecutive frames without normals


@dataclass(frozen=True)
class PictureErrors:
    """The errors of one frame's mask and normals."""

    parameters: ErrorParameters
    level: float  # factor on all errors; 0 is exact
    camera: Camera
    seed: tuple[int, ...]  # seed of their random numbers
    confusion: Confusion = Confusion()
    no_normals: bool = False  # drop the frame's normals
    as_rendered: bool = False  # start from the rendered pictures, not from the 8-bit files

    def apply(self, mask: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Degrade a true mask (H, W) and true normals (H, W, 3) in camera space."""
        _, errors = np.random.SeedSequence(self.seed).spawn(2)  # the first is the renderer's
        of_mask, of_normals = (np.random.default_rng(s) for s in errors.spawn(2))
        found, level = self.parameters, self.level
        mask = noisy_mask(mask, found.mask, level, of_mask, self.confusion)
        if self.no_normals:
            return mask, None
        return mask, noisy_normals(normals, mask, found.normal, level, of_normals)

    @property
    def convention(self) -> Convention:
        """The convention of the files of normals."""
        return self.parameters.normal.convention_at(self.level)


@dataclass(frozen=True)
class Pipeline:
    """A pipeline that estimates poses, masks and normals of a recording."""

    options: SynthOptions  # error model, levels and seed
    body: BodyModel  # of the estimated poses
    cameras: Sequence[Camera]  # the true cameras of all frames
    near: Closest  # ground truth on this body

    @property
    def errors(self) -> ErrorParameters:
        return draw_errors(self.options.error_model, self.options.seed_of_noise)

    def pictures(self) -> list[PictureErrors]:
        """Draw the errors of mask and normals of each frame."""
        options, errors, level = self.options, self.errors, self.options.noise
        confused = confusions(
            self.body, self.near.pose, self.near.shape, self.cameras[0], errors.mask, level,
            options.random(MISTAKEN, errors=True),
        )  # fmt: skip
        share = min(level * errors.normal.missing, 0.9)
        missing = runs(options.random(MISSING, errors=True), len(confused), share, MISSING_FRAMES)
        seed, exact = (*options.entropy(RENDER, errors=True), MOTION), options.error_model == EXACT
        return [
            PictureErrors(errors, level, camera, (*seed, k), seen, bool(gone), exact)
            for k, (camera, seen, gone) in enumerate(
                zip(self.cameras, confused, missing, strict=True)
            )
        ]

    def write(self, folder: Path) -> None:
        """Write poses, cameras, the convention of normals, and ``noise.json``."""
        options, errors, level = self.options, self.errors, self.options.noise
        truth, rng = (self.near.pose, self.near.shape), options.random(NOISE, errors=True)
        first = self.cameras[0]
        found = noisy_poses(self.body, *truth, first, errors.pose, level, rng)
        writer = SubjectWriter(folder)
        writer.poses(*found, stage=1)
        writer.cameras([estimated_camera(camera, errors.pose, level) for camera in self.cameras])
        if (convention := errors.normal.convention_at(level)) != "perspective":
            writer.normals_record(convention)
        about = {
            "error_model": options.error_model,
            "seed": options.seed_of_noise,
            "level": level,
            "parameters": asdict(errors),
            "floor": {"joint_mm": self.near.joint_mm, "limb_mm": self.near.limb_mm},
        }
        write_json(folder / "noise.json", about)


def describe_errors(folder: Path) -> list[str]:
    """Describe the errors of a subject's folder in a line or two."""
    path, expected = Path(folder) / "noise.json", "what gva-mi synth writes"
    found = read_json(path, expected)
    with expecting(path, expected):
        model, seed, level = (found[key] for key in ("error_model", "seed", "level"))
        lines = [f"noise: error model {model}, seed {seed}, level {level:g}"]
        if found["floor"]["joint_mm"] > 0:
            near = f"{found['floor']['limb_mm']:.1f} mm"
            lines.append(f"the fitted body comes as near as {near} to the joints of the limbs")
        return lines


def write_estimates(
    folder: Path,
    index: int,
    errors: PictureErrors,
    samples: int,
    rendered: tuple[np.ndarray, np.ndarray] | None = None,
) -> None:
    """Write mask and normals with errors for a frame whose ground truth is in ``truth``.

    ``samples`` are the rays per pixel of the ground truth; ``rendered`` are mask (H, W) and normals
    (H, W, 3) to degrade instead of its files.
    """
    truth = rendered
    if truth is None:  # 8 bits hold the mask, a fraction of the rays, exactly
        stored = read_image(folder / TRUTH / MASKS / frame_name(index), 1)
        hits = np.round(stored * (samples / 255))
        maps = NormalMaps(folder / TRUTH / NORMALS, "perspective", None)
        truth = (hits / samples).astype(np.float32), maps.read(index, errors.camera)
    mask, normals = errors.apply(*truth)
    if normals is not None:
        normals = in_convention(normals, errors.camera, errors.convention)
    write_pictures(folder, index, mask, normals)


def write_pictures(folder: Path, index: int, mask: np.ndarray, normals: np.ndarray | None) -> None:
    """Write a frame's mask (H, W) and normals (H, W, 3), which may be missing."""
    writer = SubjectWriter(folder)
    writer.mask(index, mask)
    (folder / NORMALS).mkdir(exist_ok=True)
    if normals is not None:
        writer.normals(index, normals)
