"""Makes a subject's folder: the video a real pipeline would have, and its truth apart.

The pictures are sRGB-encoded, the person on white, blended by the true mask (see ``render``).
``truth/surface.ply`` is the whole outer surface, clothes and hair included, in the rest pose.
``truth/novel_view`` shows video frames (``splits.json`` says which) from other sides with their true poses;
``truth/novel_pose`` shows poses the video does not hold.
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
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel
from gva_mi.data.pictures import write_image, write_movie
from gva_mi.data.synthetic import motion, noise
from gva_mi.data.synthetic.render import Picture, Renderer
from gva_mi.data.synthetic.subject import Subject, make_subject_body
from gva_mi.data.video import TEST_EVERY, Splits, save_cameras
from gva_mi.errors import InputError
from gva_mi.splat import Camera, look_at

Progress = Callable[..., None]
MARGIN = 0.06  # of the picture's height, kept free around the person


@dataclass(frozen=True)
class SynthOptions:
    """A synthetic subject."""

    seed: int = 0  # another seed is another person: shape, clothes, hair, colours, motion, noise
    frames: int = 80  # of the video, which is one full turn
    size: int = 512  # pixels, width and height of the pictures
    samples: int = 16  # rays per pixel, a square number
    clothes: bool = True  # clothes and shoes; without them a swimsuit is painted on the skin
    hair: bool = True
    noise: float = 1.0  # level of all errors below; 0 makes poses, masks and normals exact
    pose_noise: float = 1.0  # of the stage-1 poses; 1 is a vertex error of about 66 mm
    mask_noise: float = 1.0  # of the masks; 1 is a boundary off by about 1 pixel at 512
    normal_noise: float = 1.0  # of the normals; 1 is a blur of 2 pixels at 512 and about 8 degrees
    novel_poses: int = 8  # pictures of poses that the video does not hold
    novel_views: int = 8  # pictures of video frames from other sides

    def __post_init__(self) -> None:
        least = {"seed": 0, "frames": 1, "size": 16, "samples": 1, "novel_poses": 0, "novel_views": 0}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise InputError(f"synth: {name} must be at least {low}, got {getattr(self, name)}")
        if round(self.samples**0.5) ** 2 != self.samples:
            raise InputError(f"synth: samples must be a square number, got {self.samples}")
        for name in ("noise", "pose_noise", "mask_noise", "normal_noise"):
            if not 0 <= getattr(self, name) <= 10:
                raise InputError(f"synth: {name} must be in [0, 10], got {getattr(self, name)}")


def make_subject(
    out: Path, options: SynthOptions, body: BodyModel, progress: Progress | None = None
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
    total = options.frames + options.novel_poses + options.novel_views
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    subject = make_subject_body(body, options.seed, options.clothes, options.hair)
    renderer = Renderer(subject)
    rng = lambda stream: np.random.default_rng([options.seed, stream])
    pose = motion.turn(options.frames, body.num_expressions, rng(1))
    pose = _on_the_ground(subject, body, pose, together=True)
    camera = _video_camera(_surface(subject, body, pose), options.size, 1.45)
    with _finished_folder(out) as folder:
        _write_video(folder, options, body, subject, pose, camera, renderer, step)
        _write_novel_poses(folder, options, body, subject, renderer, step)
        views = _write_novel_views(folder, options, body, subject, pose, renderer, step)
        splits = Splits.every(TEST_EVERY, options.frames)
        _write_json(
            folder / "splits.json",
            {
                "train": splits.train, "test": splits.test,
                "novel_pose": list(range(options.novel_poses)), "novel_view": views,
            },
        )  # fmt: skip
        _write_surface(folder / "truth" / "surface.ply", subject)
        _write_json(
            folder / "synth.json",
            {"options": asdict(options), "seed": options.seed, "versions": _versions()},
        )


def _write_video(
    folder: Path,
    options: SynthOptions,
    body: BodyModel,
    subject: Subject,
    pose: Pose,
    camera: Camera,
    renderer: Renderer,
    step: Callable[[], None],
) -> None:
    rng = np.random.default_rng([options.seed, 2])
    masks, normals, levels = [], [], {}
    levels["pose"] = options.noise * options.pose_noise
    levels["mask"] = options.noise * options.mask_noise
    levels["normal"] = options.noise * options.normal_noise
    frames = []
    for k in range(options.frames):
        vertices = _surface(subject, body, pose[k])[0]
        picture = renderer(vertices, camera, options.samples, _seed(options, 0, k))
        mask = noise.noisy_mask(picture.mask, levels["mask"], rng)
        normal = noise.noisy_normals(picture.normals, mask, levels["normal"], rng)
        name = f"{k:06d}.png"
        frames.append(_bytes(picture.color))
        write_image(folder / "frames" / name, frames[-1])
        _write_truth(folder / "truth", name, picture)
        write_image(folder / "masks" / name, mask)
        write_image(folder / "normals" / name, _colors(normal))
        masks.append(noise.mask_iou(mask, picture.mask))
        normals.append(noise.normal_error(normal, picture.normals))
        step()
    write_movie(folder / "video.mp4", frames)
    save_cameras(folder / "cameras.npz", [camera])

    noisy, shape = noise.noisy_poses(pose, subject.shape, camera, levels["pose"], rng)
    save_poses(folder / "poses.npz", noisy, shape, stage=1)
    save_poses(folder / "truth" / "poses.npz", pose, subject.shape, stage=0)
    error = noise.pose_error(body, noisy, shape, pose, subject.shape)
    _write_json(
        folder / "noise.json",
        {
            "levels": levels,
            "pose": asdict(error),
            "mask": {"iou": float(np.mean(masks))},
            "normal": {"angle_deg": float(np.mean(normals))},
        },
    )


def _write_novel_poses(
    folder: Path,
    options: SynthOptions,
    body: BodyModel,
    subject: Subject,
    renderer: Renderer,
    step: Callable[[], None],
) -> None:
    if options.novel_poses == 0:
        return
    rng = np.random.default_rng([options.seed, 3])
    pose = motion.novel(options.novel_poses, body.num_expressions, rng)
    pose = _on_the_ground(subject, body, pose, together=False)
    camera = _video_camera(_surface(subject, body, pose), options.size, 1.45)
    cameras = [camera] * len(pose)
    _write_set(folder / "truth" / "novel_pose", options, body, subject, pose, cameras, renderer, step, 1)


def _write_novel_views(
    folder: Path,
    options: SynthOptions,
    body: BodyModel,
    subject: Subject,
    pose: Pose,
    renderer: Renderer,
    step: Callable[[], None],
) -> list[int]:
    """Frames of the video from other sides and heights; returns which frames."""
    count = min(options.novel_views, options.frames)
    if count == 0:
        return []
    rng = np.random.default_rng([options.seed, 4])
    frames = [int(k) for k in np.linspace(0, options.frames, count, endpoint=False)]
    cameras = []
    for k in frames:
        azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
        elevation = rng.uniform(-0.05, 0.45)
        surface = _surface(subject, body, pose[k])
        cameras.append(_video_camera(surface, options.size, 1.45, azimuth, elevation))
    _write_set(
        folder / "truth" / "novel_view", options, body, subject, pose[frames], cameras, renderer, step, 2
    )
    return frames


def _write_set(
    folder: Path,
    options: SynthOptions,
    body: BodyModel,
    subject: Subject,
    pose: Pose,
    cameras: list[Camera],
    renderer: Renderer,
    step: Callable[[], None],
    stream: int,
) -> None:
    for k, camera in enumerate(cameras):
        vertices = _surface(subject, body, pose[k])[0]
        picture = renderer(vertices, camera, options.samples, _seed(options, stream, k))
        write_image(folder / "frames" / f"{k:06d}.png", picture.color)
        _write_truth(folder, f"{k:06d}.png", picture)
        step()
    save_cameras(folder / "cameras.npz", cameras)
    save_poses(folder / "poses.npz", pose, subject.shape, stage=0)


def _write_truth(folder: Path, name: str, picture: Picture) -> None:
    write_image(folder / "masks" / name, picture.mask)
    write_image(folder / "normals" / name, _colors(picture.normals))


def _surface(subject: Subject, body: BodyModel, pose: Pose) -> np.ndarray:
    """The outer surface in the world, (T, N, 3)."""

    transforms = body(pose, subject.shape).T_world_rest
    rest = torch.from_numpy(subject.vertices)
    return np.stack([skin_points(rest, subject.weights, T).numpy() for T in transforms])


def _on_the_ground(subject: Subject, body: BodyModel, pose: Pose, together: bool) -> Pose:
    """Lift poses so that the lowest point stands at y = 0, of all frames or of each."""

    lowest = _surface(subject, body, pose)[..., 1].min(1)
    lift = np.full(len(lowest), lowest.min()) if together else lowest
    transl = pose.transl.clone()
    transl[:, 1] -= torch.from_numpy(lift)
    return replace(pose, transl=transl)


def _video_camera(
    surface: np.ndarray, size: int, focal: float, azimuth: float = 0.0, elevation: float = 0.06
) -> Camera:
    """A camera that holds all of some surfaces (T, N, 3) in its picture.

    Args:
        surface: points in the world, metres.
        size: pixels, width and height.
        focal: focal length over the picture's width.
        azimuth, elevation: where the camera stands around the person, radians.
    """
    middle = (surface.min((0, 1)) + surface.max((0, 1))) / 2
    away = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
    )
    # The principal point lies off the middle, as in cropped videos.
    centre = np.array([0.515 * size, 0.485 * size])
    free = 0.5 * size * (1 - 2 * MARGIN) - 0.015 * size
    distance = 2.0
    for _ in range(30):  # a step back until everything is inside; converges geometrically
        camera = Camera(
            focal * size, focal * size, *centre, look_at(middle + distance * away, middle), size, size
        )
        reach = np.abs(camera.project(surface) - centre).max()
        distance *= max(reach / free, 0.2)
        if abs(reach / free - 1) < 1e-4:
            break
    return camera


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


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def _colors(normals: np.ndarray) -> np.ndarray:
    return (normals + 1) / 2


def _seed(options: SynthOptions, stream: int, frame: int) -> int:
    return int(np.random.SeedSequence([options.seed, 5, stream, frame]).generate_state(1)[0])


def _versions() -> dict[str, str]:
    import drjit
    import mitsuba

    return {
        "gva_mi": gva_mi.__version__, "python": platform.python_version(),
        "mitsuba": mitsuba.__version__, "drjit": drjit.__version__,
        "torch": torch.__version__, "numpy": np.__version__,
    }  # fmt: skip
