"""Makes a subject's folder: the video that a real pipeline would have, and its truth beside it.

The pictures are sRGB-encoded, the person on white, blended by the true mask (see ``render``).
``truth/surface.ply`` is the whole outer surface, clothes and hair included, in the rest pose.
Background, blur and sensor noise, where they are asked for, are in ``frames`` alone, so that then
the masks matter; the pictures in ``truth`` stay clean.
``truth/poses.npz`` are the poses of the body that was drawn, which is ``truth/body.npz`` where it
is not the fitted one; the other poses of the folder belong to the fitted body, see ``closest``.
What the folder says outside ``truth`` is what a pipeline would say, see ``estimates``: the camera
too, whose focal length may be misjudged, so that the true one is ``truth/cameras.npz``.
``truth/novel_view`` shows video frames from other sides with their true poses (``splits.json`` says
which frames); ``truth/novel_pose`` shows poses that the video does not hold.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

import gva_mi
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.data.fingerprint import fingerprint
from gva_mi.data.pictures import write_movie
from gva_mi.data.synthetic import motion
from gva_mi.data.synthetic.camera_effects import room_background
from gva_mi.data.synthetic.closest import Closest, closest
from gva_mi.data.synthetic.clothes.folds import MEMORY
from gva_mi.data.synthetic.estimates import Pipeline
from gva_mi.data.synthetic.options import (
    BACKGROUND,
    MOTION,
    NOVEL_POSE,
    NOVEL_VIEW,
    RENDER,
    SynthOptions,
)
from gva_mi.data.synthetic.recorded import SURFACE, write_surface
from gva_mi.data.synthetic.render import camera_around
from gva_mi.data.synthetic.shots import CameraEffects, Shot, ShotPool, Taken
from gva_mi.data.synthetic.subject import Subject, draw_subject
from gva_mi.data.truth import BODY
from gva_mi.data.video import TEST_EVERY, Splits, save_cameras
from gva_mi.files import whole_folder, write_arrays, write_json
from gva_mi.splat import Camera

THINNED = 11  # every 11th vertex is enough to find the ground and to place a camera


def make_subject(
    out: Path,
    options: SynthOptions,
    body: BodyModel,
    progress: Callable[..., None] | None = None,
    replaced: str | None = None,
) -> None:
    """Write a subject's folder; it appears when it is complete, and not before.

    Args:
        out: the folder, which must not exist or be empty.
        options: what to make.
        body: the one that its stage-1 poses belong to; it is also drawn on it, unless
            ``options.figure`` says otherwise.
        progress: called as ``progress(done, total)`` after each picture.
        replaced: the marker of a folder that may be replaced, once the new one is complete.

    Raises:
        InputError: where ``out`` already holds something else.
    """
    out = Path(out)
    views = min(options.novel_views, options.frames)
    total, done = options.frames + options.novel_poses + views, 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    drawn_on = options.drawn_on(body)
    subject = draw_subject(drawn_on, options.person(drawn_on), options.clothes, options.hair)
    with whole_folder(out, replaced) as folder, ShotPool(subject, options.workers, step) as pool:
        recording = Recording(options, drawn_on, body, subject, pool)
        poses = recording.video_poses()
        _write_video(folder, recording, poses)
        _write_novel_poses(folder / "truth" / "novel_pose", recording)
        seen = _write_novel_views(folder / "truth" / "novel_view", recording, poses, views)
        splits = asdict(Splits.every(TEST_EVERY, options.frames))
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        write_json(folder / "splits.json", splits)
        write_surface(folder / SURFACE, subject)
        about = {"options": options.recorded(), "seed": options.seed, "versions": _versions()}
        about["body"] = fingerprint(body)
        write_json(folder / "synth.json", about)


@dataclass(frozen=True)
class Recording:
    """The subject, the poses it goes through, and the pool that renders it."""

    options: SynthOptions
    body: BodyModel  # that the subject is drawn on
    fitted: BodyModel  # that the poses of the video belong to
    subject: Subject
    pool: ShotPool

    def some_points(self, pose: Pose) -> np.ndarray:
        """Some points of the surface without folds, (T, n, 3), metres."""
        return self.subject.thinned(THINNED).posed(self.body, pose)

    def video_poses(self) -> list[Pose]:
        """The video's poses, and those a step, two steps, ... before each of its frames."""
        options = self.options
        joints = self.body.rest(self.subject.shape).joints.numpy()
        t = motion.times(options.frames)
        back = range(MEMORY + 1 if options.folds > 0 else 1)
        expressions = self.body.num_expressions
        poses = [
            motion.perform(
                options.motion, motion.before(t, k), joints, expressions, options.random(MOTION)
            )
            for k in back
        ]
        # The lowest point stands on the ground: of the whole turn, which does not leave it, or of
        # every frame.
        lowest = self.some_points(poses[0])[..., 1].min(1)
        if options.motion == "turn":
            lowest = np.full_like(lowest, lowest.min())
        drops = [np.interp(motion.before(t, k), t, lowest, period=1) for k in back]
        return [_lowered(p, drop.astype("f4")) for p, drop in zip(poses, drops, strict=True)]

    def video_cameras(self, pose: Pose) -> list[Camera]:
        """The video's cameras, one for each frame: all the same, or on a circle round all poses."""
        points, count = self.some_points(pose), len(pose)
        turns = np.zeros(count) if self.options.camera == "stands" else np.arange(count) / count
        of_turn = {turn: camera_around(points, self.options.size, 2 * np.pi * turn)
                   for turn in dict.fromkeys(turns.tolist())}  # fmt: skip
        return [of_turn[turn] for turn in turns.tolist()]

    def closest(self, pose: Pose) -> Closest:
        """The fitted body in true poses; they themselves, where the subject is drawn on it."""
        return closest(self.fitted, self.body, pose, self.subject.shape)

    def shots(
        self,
        folder: Path,
        poses: Sequence[Pose],
        cameras: Sequence[Camera],
        stream: int,
        taken: Sequence[Taken] = (),
    ) -> Iterator[Shot]:
        """A shot of each frame; what is random in it depends on stream and frame alone.

        Args:
            folder: gets the files.
            poses: of all frames, and those a step, two steps, ... before.
            cameras: one for each frame.
            stream: of random numbers.
            taken: how each differs from the truth; without it, they are the truth.
        """
        options = self.options
        for k, camera in enumerate(cameras):
            now, *past = (p[k] for p in poses)
            surface = self.subject.posed(self.body, now, past, options.folds)[0]
            seed = (*options.entropy(RENDER), stream, k)
            worse = taken[k] if taken else None
            yield Shot(folder, k, surface, camera, options.samples, seed, worse, options.light)


def _lowered(pose: Pose, drop: np.ndarray) -> Pose:
    """Poses moved down by ``drop`` (T,), metres."""
    transl = pose.transl.clone()
    transl[:, 1] -= torch.from_numpy(drop)
    return replace(pose, transl=transl)


def _write_video(folder: Path, recording: Recording, poses: list[Pose]) -> None:
    """Frames, masks, normals, cameras and poses of the video, with their truth."""
    options, subject, pose = recording.options, recording.subject, poses[0]
    cameras = recording.video_cameras(pose)
    save_cameras(folder / "truth" / "cameras.npz", cameras)
    save_poses(folder / "truth" / "poses.npz", pose, subject.shape, stage=0)
    if recording.body is not recording.fitted:
        write_arrays(folder / "truth" / BODY, **recording.body.arrays())
    effects = CameraEffects(
        options.blur * options.size / 512, options.sensor_noise,
        room_background(options.size, options.random(BACKGROUND)) if options.background else None,
    )  # fmt: skip
    pipeline = Pipeline(options, recording.fitted, cameras, recording.closest(pose))
    from_files = pipeline.starts_from_files
    taken = [Taken(effects, noise, from_files) for noise in pipeline.pictures()]
    shots = recording.shots(folder, poses, cameras, MOTION, taken)
    results = list(recording.pool.render(shots))
    write_movie(folder / "video.mp4", [result.color for result in results])
    pipeline.write(folder, [result.error for result in results])


def _write_novel_poses(folder: Path, recording: Recording) -> None:
    """Poses that the video does not hold, with their pictures."""
    options = recording.options
    count, rng = options.novel_poses, options.random(NOVEL_POSE)
    if count == 0:
        return
    pose = motion.novel(count, recording.body.num_expressions, rng)  # held: nothing lags behind
    pose = _lowered(pose, recording.some_points(pose)[..., 1].min(1))
    cameras = [camera_around(points, options.size) for points in recording.some_points(pose)]
    _write_truth_set(folder, recording, [pose], cameras, NOVEL_POSE)


def _write_novel_views(
    folder: Path, recording: Recording, poses: list[Pose], count: int
) -> list[int]:
    """Frames of the video from other sides and heights; returns which frames."""
    if count == 0:
        return []
    options = recording.options
    rng = options.random(NOVEL_VIEW)
    seen = [k * len(poses[0]) // count for k in range(count)]
    poses = [pose[seen] for pose in poses]
    cameras = []
    for points in recording.some_points(poses[0]):
        azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
        elevation = rng.uniform(-0.05, 0.45)
        cameras.append(camera_around(points, options.size, azimuth, elevation))
    _write_truth_set(folder, recording, poses, cameras, NOVEL_VIEW)
    return seen


def _write_truth_set(
    folder: Path, recording: Recording, poses: list[Pose], cameras: list[Camera], stream: int
) -> None:
    """Exact pictures, masks, normals, cameras and poses."""
    for _ in recording.pool.render(recording.shots(folder, poses, cameras, stream)):
        pass
    save_cameras(folder / "cameras.npz", cameras)
    near = recording.closest(poses[0])  # for avatars, which live on the fitted body
    save_poses(folder / "poses.npz", near.pose, near.shape, stage=0)


def _versions() -> dict[str, str]:
    import drjit
    import mitsuba

    return {
        "gva_mi": gva_mi.__version__, "python": platform.python_version(),
        "mitsuba": mitsuba.__version__, "drjit": drjit.__version__,
        "torch": torch.__version__, "numpy": np.__version__,
    }  # fmt: skip
