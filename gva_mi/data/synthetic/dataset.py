"""Makes a subject's folder: the video a real pipeline would have, and its truth apart.

The pictures are sRGB-encoded, the person on white, blended by the true mask (see ``render``).
``truth/surface.ply`` is the whole outer surface, clothes and hair included, in the rest pose.
A background, blur and sensor noise are in ``frames`` alone, so that then the masks matter; the
pictures in ``truth`` stay clean.
``truth/novel_view`` shows video frames from other sides with their true poses (``splits.json`` says
which frames); ``truth/novel_pose`` shows poses the video does not hold.
"""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

import gva_mi
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.data.fingerprint import fingerprint
from gva_mi.data.pictures import write_movie
from gva_mi.data.synthetic import exposure as sensor
from gva_mi.data.synthetic import motion, noise
from gva_mi.data.synthetic.folds import MEMORY
from gva_mi.data.synthetic.people import STUDY, Person
from gva_mi.data.synthetic.render import camera_around
from gva_mi.data.synthetic.studio import Shot, Stage1, Studio
from gva_mi.data.synthetic.subject import Subject, draw_subject
from gva_mi.data.video import TEST_EVERY, Splits, save_cameras
from gva_mi.errors import InputError
from gva_mi.splat import Camera

# One stream of random numbers for each thing that is drawn.
MOTION, NOISE, NOVEL_POSE, NOVEL_VIEW, RENDER, BEHIND = range(1, 7)
THINNED = 11  # every so manieth vertex is enough to find the ground and to place a camera


@dataclass(frozen=True)
class SynthOptions:
    """A synthetic subject."""

    seed: int = 0  # another seed is another person: shape, clothes, hair, colours, motion, noise
    subject: str | None = None  # one of the study's seven by name; the seed varies motion, noise
    motion: Literal["turn", "everyday"] = "turn"  # everyday: with a squat, steps, busy arms
    frames: int = 80  # of the video, which is one full turn
    size: int = 512  # pixels, width and height of the pictures
    samples: int = 16  # rays per pixel, a square number
    clothes: bool = True  # clothes and shoes; without them a swimsuit is painted on the skin
    hair: bool = True  # without it the head is bald
    folds: float = 1.0  # factor on creases where cloth bends and on ends that lag; 0: skinned only
    noise: float = 1.0  # factor on the three levels below; 0: exact poses, masks and normals
    pose_noise: float = 1.0  # of the stage-1 poses; 1 is a vertex error of about 66 mm
    mask_noise: float = 1.0  # of the masks; 1 is a boundary off by about 1 pixel at 512
    normal_noise: float = 1.0  # of the normals; 1 is a blur of 2 pixels at 512 and about 9 degrees
    novel_poses: int = 8  # pictures of poses that the video does not hold
    novel_views: int = 8  # pictures of video frames from other sides
    background: bool = False  # a room behind the person, in the frames of the video
    blur: float = 0.0  # of these frames, pixels at 512
    sensor_noise: float = 0.0  # of these frames; 1 is about 1.5 % of white
    workers: int = 1  # processes that take pictures; any number gives the same bits

    def __post_init__(self) -> None:
        least = dict(seed=0, frames=2, size=16, samples=1, novel_poses=0, novel_views=0, workers=1)
        for name, low in least.items():
            if getattr(self, name) < low:
                raise InputError(f"synth: {name} must be at least {low}, got {getattr(self, name)}")
        if round(self.samples**0.5) ** 2 != self.samples:
            raise InputError(f"synth: samples must be a square number, got {self.samples}")
        levels = ("noise", "pose_noise", "mask_noise", "normal_noise", "blur", "sensor_noise")
        for name in (*levels, "folds"):
            if not 0 <= getattr(self, name) <= 10:
                raise InputError(f"synth: {name} must be in [0, 10], got {getattr(self, name)}")
        for name, known in (("subject", (None, *STUDY)), ("motion", tuple(motion.MOTIONS))):
            if getattr(self, name) not in known:
                names = ", ".join(str(k) for k in known if k)
                raise InputError(f"synth: no {name} '{getattr(self, name)}'; there are: {names}")

    def person(self, body: BodyModel) -> Person:
        """Who it is."""
        if self.subject is not None:
            return STUDY[self.subject]
        return Person.draw(self.seed, body.num_betas)

    def entropy(self, stream: int) -> tuple[int, ...]:
        """What seeds one of the streams above; no two of the study's subjects share it."""
        named = () if self.subject is None else (STUDY[self.subject].seed,)
        return (self.seed, stream, *named)


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

    subject = draw_subject(body, options.person(body), options.clothes, options.hair)
    with _finished_folder(out) as folder, Studio(subject, options.workers, step) as studio:
        stage = Stage(options, body, subject, studio)
        pose = _write_video(folder, stage)
        _write_novel_poses(folder / "truth" / "novel_pose", stage)
        seen = _write_novel_views(folder / "truth" / "novel_view", stage, pose, views)
        splits = asdict(Splits.every(TEST_EVERY, options.frames))
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        _write_json(folder / "splits.json", splits)
        _write_surface(folder / "truth" / "surface.ply", subject)
        made_of = asdict(options)
        del made_of["workers"]  # they change nothing
        about = {"options": made_of, "seed": options.seed, "versions": _versions()}
        about["body"] = fingerprint(body)
        _write_json(folder / "synth.json", about)


def describe_noise(folder: Path) -> list[str]:
    """What the noise of a subject's folder is like, in a few lines for people."""
    noise = json.loads((Path(folder) / "noise.json").read_text())
    pose, levels = noise["pose"], noise["levels"]
    lost = len(pose["lost_left_hand"]), len(pose["lost_right_hand"])
    return [
        f"stage-1 poses (level {levels['pose']:g}): body {pose['vertex_mm']:.0f} mm, hands "
        f"{pose['hand_vertex_mm']:.0f}, feet {pose['foot_vertex_mm']:.0f}; sideways "
        f"{pose['sideways']:.1f} times the rotation error; left hand lost in {lost[0]} frames, "
        f"right in {lost[1]}",
        f"masks (level {levels['mask']:g}): IoU {noise['mask']['iou']:.3f} with the truth",
        f"normals (level {levels['normal']:g}): {noise['normal']['angle_deg']:.1f} degrees off",
    ]


@dataclass(frozen=True)
class Stage:
    """The person, what it does, and who takes pictures of it."""

    options: SynthOptions
    body: BodyModel
    subject: Subject
    studio: Studio

    def random(self, stream: int) -> np.random.Generator:
        """The random numbers of one of the streams above."""
        return np.random.default_rng(self.options.entropy(stream))

    def rough(self, pose: Pose) -> np.ndarray:
        """Some points of the surface without folds, (T, n, 3), metres."""
        return self.subject.thinned(THINNED).posed(self.body, pose)

    def lifted(self, pose: Pose, lift: np.ndarray) -> Pose:
        """Poses moved down by ``lift`` (T,), metres."""
        transl = pose.transl.clone()
        transl[:, 1] -= torch.from_numpy(lift)
        return replace(pose, transl=transl)

    def performed(self) -> list[Pose]:
        """The video's poses, and those a step, two steps, ... before each of its frames."""
        options = self.options
        perform = motion.MOTIONS[options.motion]
        t = motion.times(options.frames)
        back = range(MEMORY + 1 if options.folds > 0 else 1)
        expressions = self.body.num_expressions
        poses = [perform(motion.before(t, k), expressions, self.random(MOTION)) for k in back]
        # The lowest point stands on the ground: of the whole turn, which does not leave it, or of
        # every frame.
        lowest = self.rough(poses[0])[..., 1].min(1)
        if options.motion == "turn":
            lowest = np.full_like(lowest, lowest.min())
        lifts = [np.interp(motion.before(t, k), t, lowest, period=1) for k in back]
        return [self.lifted(p, a.astype("f4")) for p, a in zip(poses, lifts, strict=True)]

    def shots(
        self,
        folder: Path,
        poses: Sequence[Pose],
        cameras: Sequence[Camera],
        stream: int,
        stage1: Stage1 | None = None,
    ) -> Iterator[Shot]:
        """A shot of each frame; what is random in it depends on stream and frame alone."""
        options = self.options
        for k, camera in enumerate(cameras):
            now, *past = (p[k] for p in poses)
            surface = self.subject.posed(self.body, now, past, options.folds)[0]
            seed = (*options.entropy(RENDER), stream, k)
            yield Shot(folder, k, surface, camera, options.samples, seed, stage1)


def _write_video(folder: Path, stage: Stage) -> list[Pose]:
    """Frames, masks, normals, cameras and poses, with their truth; returns the performed poses."""
    options, subject = stage.options, stage.subject
    poses = stage.performed()
    pose = poses[0]
    camera = camera_around(stage.rough(pose), options.size)
    levels = {
        "pose": options.noise * options.pose_noise,
        "mask": options.noise * options.mask_noise,
        "normal": options.noise * options.normal_noise,
    }
    noisy, shape = noise.noisy_poses(
        pose, subject.shape, camera, levels["pose"], stage.random(NOISE)
    )
    behind = sensor.backdrop(options.size, stage.random(BEHIND)) if options.background else None
    blur = options.blur * options.size / 512
    stage1 = Stage1(
        folder / "truth", levels["mask"], levels["normal"], blur, options.sensor_noise, behind
    )
    shots = stage.shots(folder, poses, [camera] * options.frames, MOTION, stage1)
    taken = list(stage.studio.take(shots))
    write_movie(folder / "video.mp4", [t.color for t in taken])
    save_cameras(folder / "cameras.npz", [camera])
    save_poses(folder / "poses.npz", noisy, shape, stage=1)
    save_poses(folder / "truth" / "poses.npz", pose, subject.shape, stage=0)
    error = noise.pose_error(stage.body, noisy, shape, pose, subject.shape, camera)
    statistics = {
        "levels": levels,
        "pose": asdict(error),
        "mask": {"iou": float(np.mean([t.iou for t in taken]))},
        "normal": {"angle_deg": float(np.mean([t.angle for t in taken]))},
    }
    _write_json(folder / "noise.json", statistics)
    return poses


def _write_novel_poses(folder: Path, stage: Stage) -> None:
    count, rng = stage.options.novel_poses, stage.random(NOVEL_POSE)
    if count == 0:
        return
    pose = motion.novel(count, stage.body.num_expressions, rng)  # held: nothing lags
    pose = stage.lifted(pose, stage.rough(pose)[..., 1].min(1))
    cameras = [camera_around(points, stage.options.size) for points in stage.rough(pose)]
    _write_truth_set(folder, stage, [pose], cameras, NOVEL_POSE)


def _write_novel_views(folder: Path, stage: Stage, poses: list[Pose], count: int) -> list[int]:
    """Frames of the video from other sides and heights; returns which frames."""
    if count == 0:
        return []
    rng = stage.random(NOVEL_VIEW)
    seen = [k * len(poses[0]) // count for k in range(count)]
    poses = [pose[seen] for pose in poses]
    cameras = []
    for points in stage.rough(poses[0]):
        azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
        elevation = rng.uniform(-0.05, 0.45)
        cameras.append(camera_around(points, stage.options.size, azimuth, elevation))
    _write_truth_set(folder, stage, poses, cameras, NOVEL_VIEW)
    return seen


def _write_truth_set(
    folder: Path, stage: Stage, poses: list[Pose], cameras: list[Camera], stream: int
) -> None:
    for _ in stage.studio.take(stage.shots(folder, poses, cameras, stream)):
        pass
    save_cameras(folder / "cameras.npz", cameras)
    save_poses(folder / "poses.npz", poses[0], stage.subject.shape, stage=0)


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
