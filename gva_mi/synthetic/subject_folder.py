"""Write a subject's folder: the video that a real pipeline would have, and its ground truth.

Pictures are sRGB-encoded, the person on white, blended by the true mask (see ``render``).

Files outside ``truth`` are estimates of a pipeline (see ``estimates``), cameras included, whose
focal length may be wrong. All in ``truth`` is exact:

======================  ========================================================================
``surface.ply``         the outer surface in the rest pose, with clothes and hair
``poses.npz``           poses of the body that was drawn
``body.npz``            this body, if it is not the fitted one, see ``closest``
``cameras.npz``         the true cameras
``masks``, ``normals``  of the video
``novel_view``          frames of the video from other sides; ``splits.json`` lists them
``novel_pose``          poses that the video does not hold
======================  ========================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.files import write_arrays, write_json
from gva_mi.core.provenance import versions
from gva_mi.data.fingerprint import fingerprint
from gva_mi.data.ground_truth import BODY
from gva_mi.data.pictures import write_movie
from gva_mi.data.video import TEST_EVERY, Splits, save_cameras
from gva_mi.splat import Camera
from gva_mi.synthetic import motion
from gva_mi.synthetic.closest import Closest, closest
from gva_mi.synthetic.clothes.folds import MEMORY
from gva_mi.synthetic.estimates import PictureErrors, Pipeline
from gva_mi.synthetic.framing import camera_around
from gva_mi.synthetic.options import MOTION, NOVEL_POSE, NOVEL_VIEW, RENDER, SynthOptions
from gva_mi.synthetic.pictures import Render, RenderJob, rendering
from gva_mi.synthetic.provenance import SURFACE, write_surface
from gva_mi.synthetic.subject import Subject, draw_subject

THINNED = 11  # every 11th vertex is enough to find the ground and to place a camera


def make_subject(
    out: Path,
    options: SynthOptions,
    body: BodyModel,
    progress: Callable[..., None] | None = None,
    replaced: str | None = None,
) -> None:
    """Write a subject's folder; it appears when it is complete.

    Args:
        out: the folder, which must not exist or be empty.
        options: of the subject.
        body: of its stage-1 poses; the subject is drawn on it unless ``options.figure`` differs.
        progress: called as ``progress(done, total)`` after each picture.
        replaced: marker file of a folder that may be replaced once the new one is complete.

    Raises:
        InputError: ``out`` holds something else.
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
    with atomic_dir(out, replaced) as folder, rendering(subject, options.workers, step) as render:
        writer = _SubjectWriter(options, drawn_on, body, subject, render)
        poses = writer.video_poses()
        writer.write_video(folder, poses)
        writer.write_novel_poses(folder / "truth" / "novel_pose")
        seen = writer.write_novel_views(folder / "truth" / "novel_view", poses, views)
        splits = Splits.every(TEST_EVERY, options.frames).to_json()
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        write_json(folder / "splits.json", splits)
        write_surface(folder / SURFACE, subject)
        about = {"options": options.recorded(), "seed": options.seed, "body": fingerprint(body)}
        made_by = versions() | {"mitsuba": metadata.version("mitsuba")}
        write_json(folder / "synth.json", about | {"versions": made_by})


@dataclass(frozen=True)
class _SubjectWriter:
    options: SynthOptions
    body: BodyModel  # that the subject is drawn on
    fitted: BodyModel  # of the estimated poses
    subject: Subject
    render: Render

    def _points(self, pose: Pose) -> np.ndarray:
        """Return some points of the surface without folds, (T, n, 3), metres."""
        index = np.arange(0, len(self.subject.vertices), THINNED)
        return self.subject.skinned(self.body, pose, index)

    def video_poses(self) -> list[Pose]:
        """Return the video's poses, and those one step, two steps, ... before its frames."""
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
        # The lowest point stands on the ground, in each frame or for a turn in all frames.
        lowest = self._points(poses[0])[..., 1].min(1)
        if options.motion == "turn":
            lowest = np.full_like(lowest, lowest.min())
        drops = [np.interp(motion.before(t, k), t, lowest, period=1) for k in back]
        return [_lowered(p, drop.astype("f4")) for p, drop in zip(poses, drops, strict=True)]

    def _video_cameras(self, pose: Pose) -> list[Camera]:
        """Return a camera per frame: all the same, or on a circle around all poses."""
        points, count = self._points(pose), len(pose)
        turns = np.zeros(count) if self.options.camera == "stands" else np.arange(count) / count
        of_turn = {turn: camera_around(points, self.options.size, 2 * np.pi * turn)
                   for turn in dict.fromkeys(turns.tolist())}  # fmt: skip
        return [of_turn[turn] for turn in turns.tolist()]

    def _closest(self, pose: Pose) -> Closest:
        """Return the ground truth on the fitted body."""
        return closest(self.fitted, self.body, pose, self.subject.shape)

    def _jobs(
        self,
        folder: Path,
        poses: Sequence[Pose],
        cameras: Sequence[Camera],
        stream: int,
        errors: Sequence[PictureErrors] = (),
    ) -> Iterator[RenderJob]:
        """Yield the render job of each frame, which is random by stream and frame alone.

        ``poses`` are those of all frames, then those one step, two steps, ... before. Without
        ``errors``, one per frame, only the ground truth is written.
        """
        options = self.options
        for k, camera in enumerate(cameras):
            now, *past = (p[k] for p in poses)
            surface = self.subject.posed(self.body, now, past, options.folds)[0]
            seed = (*options.entropy(RENDER), stream, k)
            yield RenderJob(
                folder, k, surface, camera, options.samples, seed, options.light,
                errors[k] if errors else None,
            )  # fmt: skip

    def write_video(self, folder: Path, poses: list[Pose]) -> None:
        """Write frames, masks, normals, cameras and poses of the video, with ground truth."""
        options, subject, pose = self.options, self.subject, poses[0]
        cameras = self._video_cameras(pose)
        save_cameras(folder / "truth" / "cameras.npz", cameras)
        save_poses(folder / "truth" / "poses.npz", pose, subject.shape, stage=0)
        if self.body is not self.fitted:
            write_arrays(folder / "truth" / BODY, **self.body.arrays())
        pipeline = Pipeline(options, self.fitted, cameras, self._closest(pose))
        jobs = self._jobs(folder, poses, cameras, MOTION, pipeline.pictures())
        colors, statistics = zip(*self.render(jobs), strict=True)
        write_movie(folder / "video.mp4", list(colors))
        pipeline.write(folder, statistics)

    def write_novel_poses(self, folder: Path) -> None:
        """Write poses that the video does not hold, with their pictures."""
        options = self.options
        count, rng = options.novel_poses, options.random(NOVEL_POSE)
        if count == 0:
            return
        pose = motion.novel(count, self.body.num_expressions, rng)  # static: nothing lags behind
        pose = _lowered(pose, self._points(pose)[..., 1].min(1))
        cameras = [camera_around(points, options.size) for points in self._points(pose)]
        self._write_truth(folder, [pose], cameras, NOVEL_POSE)

    def write_novel_views(self, folder: Path, poses: list[Pose], count: int) -> list[int]:
        """Write ``count`` frames of the video from other sides and heights; return which."""
        if count == 0:
            return []
        options = self.options
        rng = options.random(NOVEL_VIEW)
        seen = [k * len(poses[0]) // count for k in range(count)]
        poses = [pose[seen] for pose in poses]
        cameras = []
        for points in self._points(poses[0]):
            azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
            elevation = rng.uniform(-0.05, 0.45)
            cameras.append(camera_around(points, options.size, azimuth, elevation))
        self._write_truth(folder, poses, cameras, NOVEL_VIEW)
        return seen

    def _write_truth(
        self, folder: Path, poses: list[Pose], cameras: list[Camera], stream: int
    ) -> None:
        """Write exact pictures, masks, normals, cameras and poses."""
        for _ in self.render(self._jobs(folder, poses, cameras, stream)):
            pass
        save_cameras(folder / "cameras.npz", cameras)
        near = self._closest(poses[0])  # on the fitted body, like an avatar
        save_poses(folder / "poses.npz", near.pose, near.shape, stage=0)


def _lowered(pose: Pose, drop: np.ndarray) -> Pose:
    """Move poses down by ``drop`` (T,), metres."""
    transl = pose.transl.clone()
    transl[:, 1] -= torch.from_numpy(drop)
    return replace(pose, transl=transl)
