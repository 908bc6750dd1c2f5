"""What a pipeline says about a recording: imperfect poses, camera, masks and normals.

Its noise is drawn from a family. Truth and options alone decide it, so that a recording that is
there can be given another noise, see :mod:`gva_mi.data.synthetic.degrade`: what is wrong in a
frame's mask and normals starts from the files of the truth, 8 bits a channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.data.normals import ABOUT, NormalMaps
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.synthetic.closest import Closest
from gva_mi.data.synthetic.noise.errors import mask_iou, normal_error, pose_error
from gva_mi.data.synthetic.noise.families import FAMILIES, Noise, draw
from gva_mi.data.synthetic.noise.masks import mistaken
from gva_mi.data.synthetic.noise.pictures import PictureNoise
from gva_mi.data.synthetic.noise.poses import believed_camera, noisy_poses
from gva_mi.data.synthetic.noise.processes import runs
from gva_mi.data.synthetic.options import MISSING, MISTAKEN, MOTION, NOISE, RENDER, SynthOptions
from gva_mi.data.video import save_cameras
from gva_mi.errors import expecting
from gva_mi.files import read_json, write_json
from gva_mi.splat import Camera

MISSING_FRAMES = 3.0  # frames in a row without normals, on average


@dataclass(frozen=True)
class PictureError:
    """How far one frame's mask and normals are from the truth."""

    iou: float  # of the masks
    angle: float | None  # degrees, between the normals; None where the frame has none


@dataclass(frozen=True)
class Pipeline:
    """What looks at a recording and gives poses, masks and normals for it.

    Attributes:
        options: which family of noise, at which levels, from which seed.
        body: that the poses are for.
        cameras: the true ones, of all frames.
        near: what a perfect estimator would say with that body: the truth, where it was filmed.
    """

    options: SynthOptions
    body: BodyModel
    cameras: Sequence[Camera]
    near: Closest

    @property
    def starts_from_files(self) -> bool:
        """Whether what is wrong in masks and normals starts from the files of the truth."""
        return not FAMILIES[self.options.family].exact

    @property
    def noise(self) -> Noise:
        """What goes wrong."""
        return draw(self.options.family, self.options.seed_of_noise)

    def pictures(self) -> list[PictureNoise]:
        """What goes wrong in the mask and the normals of each frame."""
        options, noise, levels = self.options, self.noise, self.options.levels
        seen = mistaken(
            self.body, self.near.pose, self.near.shape, self.cameras[0], noise.mask, levels.mask,
            options.random_noise(MISTAKEN),
        )  # fmt: skip
        share = min(levels.normal * noise.normal.missing, 0.9)
        missing = runs(options.random_noise(MISSING), len(seen), share, MISSING_FRAMES)
        seed = (*options.entropy_of_noise(RENDER), MOTION)
        return [
            PictureNoise(noise, levels, self.cameras[k], (*seed, k), seen[k], bool(missing[k]))
            for k in range(len(seen))
        ]

    def write(self, folder: Path, errors: Sequence[PictureError]) -> None:
        """Write poses, camera, how normals are written, and what the noise is like.

        Args:
            folder: the subject's.
            errors: of the masks and normals of all frames, which are there already.
        """
        options, noise, levels = self.options, self.noise, self.options.levels
        truth, rng = (self.near.pose, self.near.shape), options.random_noise(NOISE)
        first = self.cameras[0]
        found = noisy_poses(self.body, *truth, first, noise.pose, levels.pose, rng)
        save_poses(folder / "poses.npz", *found, stage=1)
        believed = [believed_camera(camera, noise.pose, levels.pose) for camera in self.cameras]
        save_cameras(folder / "cameras.npz", believed)
        if noise.normal.convention != "perspective" and levels.normal > 0:
            write_json(folder / ABOUT, {"convention": noise.normal.convention})
        angles = [error.angle for error in errors if error.angle is not None]
        statistics = {
            "family": options.family,
            "seed": options.seed_of_noise,
            "levels": asdict(levels),
            "parameters": asdict(noise),
            "pose": asdict(pose_error(self.body, *found, *truth, first)),
            "mask": {"iou": float(np.mean([error.iou for error in errors]))},
            "normal": {
                "angle_deg": float(np.mean(angles)) if angles else None,
                "missing": len(errors) - len(angles),
            },
            "floor": {"joint_mm": self.near.joint_mm, "limb_mm": self.near.limb_mm},
        }
        write_json(folder / "noise.json", statistics)


def describe_noise(folder: Path) -> list[str]:
    """What the noise of a subject's folder is like, in a few lines for people."""
    path, expected = Path(folder) / "noise.json", "what gva-mi synth writes"
    found = read_json(path, expected)
    with expecting(path, expected):
        return list(_noise_in_words(found))


def _noise_in_words(found: dict[str, Any]) -> Iterator[str]:
    """Lines about what ``noise.json`` holds."""
    pose, levels, normal = found["pose"], found["levels"], found["normal"]
    lost = len(pose["lost_left_hand"]), len(pose["lost_right_hand"])
    angle, missing = normal["angle_deg"], normal.get("missing", 0)
    known = "none" if angle is None else f"{angle:.1f} degrees off"
    floor = found.get("floor", {"joint_mm": 0.0})
    foreign = "the fitted body comes as near as {limb_mm:.1f} mm to the joints of the limbs"
    yield f"noise: family {found.get('family', 'bursts')}, seed {found.get('seed', 'unknown')}"
    yield (
        f"stage-1 poses (level {levels['pose']:g}): body {pose['vertex_mm']:.0f} mm, hands "
        f"{pose['hand_vertex_mm']:.0f}, feet {pose['foot_vertex_mm']:.0f}; sideways "
        f"{pose['sideways']:.1f} times the rotation error; left hand lost in {lost[0]} frames, "
        f"right in {lost[1]}"
    )
    yield f"masks (level {levels['mask']:g}): IoU {found['mask']['iou']:.3f} with the truth"
    also = f"; missing in {missing} frames" if missing else ""
    yield f"normals (level {levels['normal']:g}): {known}{also}"
    if floor["joint_mm"] > 0:
        yield foreign.format(**floor)


def spoil_pictures(
    folder: Path,
    index: int,
    noise: PictureNoise,
    samples: int,
    rendered: tuple[np.ndarray, np.ndarray] | None = None,
) -> PictureError:
    """Write the noisy mask and normals of a frame whose true ones are in ``truth``.

    Args:
        folder: the subject's.
        index: of the frame.
        noise: what goes wrong.
        samples: rays per pixel that the truth was rendered with.
        rendered: mask (H, W) and normals (H, W, 3) to start from in place of the files.
    """
    truth = rendered or _true_pictures(folder / "truth", index, noise.camera, samples)
    mask, normals = noise.of(*truth)
    write_image(folder / "masks" / f"{index:06d}.png", mask)
    if normals is None:
        (folder / "normals").mkdir(exist_ok=True)
        return PictureError(mask_iou(mask, truth[0]), None)
    write_normals(folder, index, noise.in_convention(normals))
    return PictureError(mask_iou(mask, truth[0]), normal_error(normals, truth[1]))


def write_normals(folder: Path, index: int, normals: np.ndarray) -> None:
    """Write normals (H, W, 3) of a frame."""
    write_image(folder / "normals" / f"{index:06d}.png", (normals + 1) / 2)


def _true_pictures(
    truth: Path, index: int, camera: Camera, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mask and normals as they were rendered, but for what 8 bits cannot hold of normals."""
    stored = read_image(truth / "masks" / f"{index:06d}.png", 1)
    hits = np.round(stored * (samples / 255))  # a mask is a share of the rays: nothing is lost
    mask = (hits / samples).astype(np.float32)
    normals = NormalMaps(truth / "normals", "perspective", None).read(index, camera)
    return mask, normals
