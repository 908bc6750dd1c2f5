"""The estimates of a pipeline for a video: poses, camera, masks and normals with errors.

They depend on the ground truth and the options alone, so a video can be degraded again
(:func:`gva_mi.synthetic.degrade`): masks and normals, from the 8-bit files of the ground truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.files import write_json
from gva_mi.splat import Camera
from gva_mi.subject.folder import MASKS, NORMALS, TRUTH, SubjectWriter, frame_name
from gva_mi.subject.normals import NormalMaps, in_convention
from gva_mi.subject.pictures import read_image
from gva_mi.synthetic.errors.closest_pose import Closest
from gva_mi.synthetic.errors.masks_and_normals import (
    Confusion,
    confusions,
    noisy_mask,
    noisy_normals,
)
from gva_mi.synthetic.errors.models import BURSTS, ErrorParameters, draw_errors
from gva_mi.synthetic.errors.poses import estimated_camera, noisy_poses, runs
from gva_mi.synthetic.options import SubjectStream, SynthOptions

MISSING_NORMALS_FRAMES = 3.0  # frames, mean length of a run without normals; chosen: short gaps


@dataclass(frozen=True)
class PictureErrors:
    """The errors of one frame's mask and normals."""

    parameters: ErrorParameters | None  # None: exact
    camera: Camera
    seed: tuple[int, ...]  # seed of their random numbers
    confusion: Confusion = Confusion()
    no_normals: bool = False  # drop the frame's normals
    as_rendered: bool = False  # start from the rendered pictures, not from the 8-bit files

    def apply(self, mask: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Degrade a true mask (H, W) and true normals (H, W, 3) in camera space."""
        if self.parameters is None:
            return mask, normals
        _, errors = np.random.SeedSequence(self.seed).spawn(2)  # the first is the renderer's
        of_mask, of_normals = (np.random.default_rng(s) for s in errors.spawn(2))
        found = self.parameters
        mask = noisy_mask(mask, found.mask, of_mask, self.confusion)
        if self.no_normals:
            return mask, None
        normals = noisy_normals(normals, mask, found.normal, of_normals)
        return mask, in_convention(normals, self.camera, found.normal.convention)


@dataclass(frozen=True)
class Pipeline:
    """A pipeline that estimates poses, masks and normals of a video."""

    options: SynthOptions  # error model and seed
    body: BodyModel  # of the estimated poses
    cameras: Sequence[Camera]  # the true cameras of all frames
    near: Closest  # ground truth on this body

    @property
    def errors(self) -> ErrorParameters | None:
        return draw_errors(self.options.error_model, self.options.seed_of_errors)

    def pictures(self) -> list[PictureErrors]:
        """Draw the errors of mask and normals of each frame."""
        options, errors = self.options, self.errors
        seed = (*options.entropy(SubjectStream.RENDER, errors=True), SubjectStream.MOTION)
        if errors is None:
            return [PictureErrors(None, camera, seed, as_rendered=True) for camera in self.cameras]
        confused = confusions(
            self.body, self.near.pose, self.near.shape, self.cameras[0], errors.mask,
            options.random(SubjectStream.SEGMENTATION_ERRORS, errors=True),
        )  # fmt: skip
        rng = options.random(SubjectStream.MISSING_NORMALS, errors=True)
        missing = runs(rng, len(confused), errors.normal.missing, MISSING_NORMALS_FRAMES)
        exact = options.error_model == BURSTS
        frames = enumerate(zip(self.cameras, confused, missing, strict=True))
        return [
            PictureErrors(errors, camera, (*seed, k), seen, bool(gone), exact)
            for k, (camera, seen, gone) in frames
        ]

    def write(self, folder: Path) -> None:
        """Write poses, cameras, the convention of normals, and ``noise.json``."""
        options, errors, near, cameras = self.options, self.errors, self.near, self.cameras
        writer, pose, shape = SubjectWriter(folder), near.pose, near.shape
        if errors is not None:
            rng = options.random(SubjectStream.POSE_ERRORS, errors=True)
            pose, shape = noisy_poses(self.body, pose, shape, cameras[0], errors.pose, rng)
            cameras = [estimated_camera(camera, errors.pose) for camera in cameras]
            if errors.normal.convention != "perspective":
                writer.normals_record(errors.normal.convention)
        writer.poses(pose, shape, stage=1)
        writer.cameras(cameras)
        about = {
            "error_model": options.error_model,
            "seed": options.seed_of_errors,
            "parameters": None if errors is None else asdict(errors),
            "floor": {"joint_mm": near.joint_mm, "limb_mm": near.limb_mm},
        }
        write_json(folder / "noise.json", about)


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
    if rendered is None:  # 8 bits hold the mask, a fraction of the rays, exactly
        stored = read_image(folder / TRUTH / MASKS / frame_name(index), 1)
        hits = np.round(stored * (samples / 255))
        maps = NormalMaps(folder / TRUTH / NORMALS, "perspective", None)
        rendered = (hits / samples).astype(np.float32), maps.read(index, errors.camera)
    write_pictures(folder, index, *errors.apply(*rendered))


def write_pictures(folder: Path, index: int, mask: np.ndarray, normals: np.ndarray | None) -> None:
    """Write a frame's mask (H, W) and normals (H, W, 3), which may be missing."""
    writer = SubjectWriter(folder)
    writer.mask(index, mask)
    (folder / NORMALS).mkdir(exist_ok=True)
    if normals is not None:
        writer.normals(index, normals)
