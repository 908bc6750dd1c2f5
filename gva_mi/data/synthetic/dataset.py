"""Makes a subject's folder: the video a real pipeline would have, and its truth apart.

The pictures are sRGB-encoded, the person on white, blended by the true mask (see ``render``).
``truth/surface.ply`` is the whole outer surface, clothes and hair included, in the rest pose.
``truth/novel_view`` shows video frames from other sides with their true poses (``splits.json`` says
which frames); ``truth/novel_pose`` shows poses the video does not hold.
"""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

import gva_mi
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.data.pictures import write_image, write_movie
from gva_mi.data.synthetic import motion, noise
from gva_mi.data.synthetic.render import Picture, Renderer, camera_around
from gva_mi.data.synthetic.subject import Subject, draw_subject
from gva_mi.data.video import TEST_EVERY, Splits, save_cameras
from gva_mi.errors import InputError
from gva_mi.splat import Camera

# One stream of random numbers for each thing that is drawn.
MOTION, NOISE, NOVEL_POSE, NOVEL_VIEW, RENDER = range(1, 6)


@dataclass(frozen=True)
class SynthOptions:
    """A synthetic subject."""

    seed: int = 0  # another seed is another person: shape, clothes, hair, colours, motion, noise
    frames: int = 80  # of the video, which is one full turn
    size: int = 512  # pixels, width and height of the pictures
    samples: int = 16  # rays per pixel, a square number
    clothes: bool = True  # clothes and shoes; without them a swimsuit is painted on the skin
    hair: bool = True  # without it the head is bald
    noise: float = 1.0  # factor on the three levels below; 0: exact poses, masks and normals
    pose_noise: float = 1.0  # of the stage-1 poses; 1 is a vertex error of about 66 mm
    mask_noise: float = 1.0  # of the masks; 1 is a boundary off by about 1 pixel at 512
    normal_noise: float = 1.0  # of the normals; 1 is a blur of 2 pixels at 512 and about 9 degrees
    novel_poses: int = 8  # pictures of poses that the video does not hold
    novel_views: int = 8  # pictures of video frames from other sides

    def __post_init__(self) -> None:
        least = dict(seed=0, frames=2, size=16, samples=1, novel_poses=0, novel_views=0)
        for name, low in least.items():
            if getattr(self, name) < low:
                raise InputError(f"synth: {name} must be at least {low}, got {getattr(self, name)}")
        if round(self.samples**0.5) ** 2 != self.samples:
            raise InputError(f"synth: samples must be a square number, got {self.samples}")
        for name in ("noise", "pose_noise", "mask_noise", "normal_noise"):
            if not 0 <= getattr(self, name) <= 10:
                raise InputError(f"synth: {name} must be in [0, 10], got {getattr(self, name)}")


def make_subject(
    out: Path,
    options: SynthOptions,
    body: BodyModel,
    progress: Callable[..., None] | None = None,
) -> None:
    """Write a subject's folder; it appears when it is complete, and not before.

    Args:
        out: the folder, which must not exist or be empty.
        options: what to make.
        body: the body it is made on.
        progress: called as ``progress(done, total)`` after each picture.

    Raises:
        InputError: where ``out`` already holds something.
    """
    out = Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: already there; expected a new or an empty folder for the subject")
    views = min(options.novel_views, options.frames)
    total, done = options.frames + options.novel_poses + views, 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    subject = draw_subject(body, options.seed, options.clothes, options.hair)
    studio = Studio(options, body, subject, Renderer(subject), step)
    with _finished_folder(out) as folder:
        pose = _write_video(folder, studio)
        _write_novel_poses(folder / "truth" / "novel_pose", studio)
        seen = _write_novel_views(folder / "truth" / "novel_view", studio, pose, views)
        splits = asdict(Splits.every(TEST_EVERY, options.frames))
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        _write_json(folder / "splits.json", splits)
        _write_surface(folder / "truth" / "surface.ply", subject)
        about = {"options": asdict(options), "seed": options.seed, "versions": _versions()}
        _write_json(folder / "synth.json", about)


@dataclass(frozen=True)
class Studio:
    """The person, and who takes pictures of it."""

    options: SynthOptions
    body: BodyModel
    subject: Subject
    renderer: Renderer
    step: Callable[[], None]  # called after each picture

    def random(self, stream: int) -> np.random.Generator:
        """The random numbers of one of the streams above."""
        return np.random.default_rng([self.options.seed, stream])

    def surface(self, pose: Pose) -> np.ndarray:
        """The outer surface in the world, (T, N, 3) float32, metres."""
        return self.subject.posed(self.body, pose)

    def picture(self, pose: Pose, camera: Camera, stream: int, frame: int) -> Picture:
        """A pose of one frame as a camera sees it; the noise depends on stream and frame alone."""
        key = [self.options.seed, RENDER, stream, frame]
        seed = int(np.random.SeedSequence(key).generate_state(1)[0])
        picture = self.renderer(self.surface(pose)[0], camera, self.options.samples, seed)
        self.step()
        return picture

    def grounded(self, pose: Pose, together: bool) -> Pose:
        """Poses moved up or down so that the lowest point is at y = 0, of all frames or of each."""
        lowest = self.surface(pose)[..., 1].min(1)
        lift = np.full_like(lowest, lowest.min()) if together else lowest
        transl = pose.transl.clone()
        transl[:, 1] -= torch.from_numpy(lift)
        return replace(pose, transl=transl)


def _write_video(folder: Path, studio: Studio) -> Pose:
    """Frames, masks, normals, cameras and poses, with their truth; returns the true poses."""
    options, subject = studio.options, studio.subject
    expressions = studio.body.num_expressions
    pose = motion.turn(options.frames, expressions, studio.random(MOTION))
    pose = studio.grounded(pose, together=True)
    camera = camera_around(studio.surface(pose), options.size)
    levels = {
        "pose": options.noise * options.pose_noise,
        "mask": options.noise * options.mask_noise,
        "normal": options.noise * options.normal_noise,
    }
    rng = studio.random(NOISE)
    noisy, shape = noise.noisy_poses(pose, subject.shape, camera, levels["pose"], rng)
    frames, overlaps, angles = [], [], []
    for k in range(options.frames):
        picture = studio.picture(pose[k], camera, MOTION, k)
        mask = noise.noisy_mask(picture.mask, levels["mask"], rng)
        normals = noise.noisy_normals(picture.normals, mask, levels["normal"], rng)
        _write_picture(folder, k, picture.color, mask, normals)
        _write_picture(folder / "truth", k, None, picture.mask, picture.normals)
        frames.append(np.round(picture.color * 255).astype(np.uint8))
        overlaps.append(noise.mask_iou(mask, picture.mask))
        angles.append(noise.normal_error(normals, picture.normals))
    write_movie(folder / "video.mp4", frames)
    save_cameras(folder / "cameras.npz", [camera])
    save_poses(folder / "poses.npz", noisy, shape, stage=1)
    save_poses(folder / "truth" / "poses.npz", pose, subject.shape, stage=0)
    error = noise.pose_error(studio.body, noisy, shape, pose, subject.shape)
    statistics = {
        "levels": levels,
        "pose": asdict(error),
        "mask": {"iou": float(np.mean(overlaps))},
        "normal": {"angle_deg": float(np.mean(angles))},
    }
    _write_json(folder / "noise.json", statistics)
    return pose


def _write_novel_poses(folder: Path, studio: Studio) -> None:
    count, rng = studio.options.novel_poses, studio.random(NOVEL_POSE)
    if count == 0:
        return
    pose = studio.grounded(motion.novel(count, studio.body.num_expressions, rng), together=False)
    size = studio.options.size
    cameras = [camera_around(studio.surface(pose[k]), size) for k in range(count)]
    _write_truth_set(folder, studio, pose, cameras, NOVEL_POSE)


def _write_novel_views(folder: Path, studio: Studio, pose: Pose, count: int) -> list[int]:
    """Frames of the video from other sides and heights; returns which frames."""
    if count == 0:
        return []
    rng = studio.random(NOVEL_VIEW)
    seen = [k * len(pose) // count for k in range(count)]
    cameras = []
    for k in seen:
        azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
        surface, elevation = studio.surface(pose[k]), rng.uniform(-0.05, 0.45)
        cameras.append(camera_around(surface, studio.options.size, azimuth, elevation))
    _write_truth_set(folder, studio, pose[seen], cameras, NOVEL_VIEW)
    return seen


def _write_truth_set(
    folder: Path, studio: Studio, pose: Pose, cameras: list[Camera], stream: int
) -> None:
    for k, camera in enumerate(cameras):
        picture = studio.picture(pose[k], camera, stream, k)
        _write_picture(folder, k, picture.color, picture.mask, picture.normals)
    save_cameras(folder / "cameras.npz", cameras)
    save_poses(folder / "poses.npz", pose, studio.subject.shape, stage=0)


def _write_picture(
    folder: Path, frame: int, color: np.ndarray | None, mask: np.ndarray, normals: np.ndarray
) -> None:
    name = f"{frame:06d}.png"
    if color is not None:
        write_image(folder / "frames" / name, color)
    write_image(folder / "masks" / name, mask)
    write_image(folder / "normals" / name, (normals + 1) / 2)


@contextmanager
def _finished_folder(out: Path) -> Iterator[Path]:
    """A folder beside ``out`` that becomes ``out`` if all goes well, and vanishes if not."""
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    folder.chmod(0o755)
    try:
        yield folder
        if out.exists():
            out.rmdir()
        folder.rename(out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_surface(path: Path, subject: Subject) -> None:
    import trimesh

    mesh = trimesh.Trimesh(subject.vertices, subject.faces, process=False)
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=False))


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n")


def _versions() -> dict[str, str]:
    import drjit
    import mitsuba

    return {
        "gva_mi": gva_mi.__version__, "python": platform.python_version(),
        "mitsuba": mitsuba.__version__, "drjit": drjit.__version__,
        "torch": torch.__version__, "numpy": np.__version__,
    }  # fmt: skip
