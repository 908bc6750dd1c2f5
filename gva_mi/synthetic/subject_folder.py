"""Write a subject's folder: the video that a real pipeline would have, and its ground truth.

Pictures are sRGB-encoded, the person on white or in a room (see ``render``); held-out ones are on
white, in the light of the room. ``film.mp4`` is the film that a phone would make in a room.

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
``film.json``           height of the person, placing of the phone, of a video in a room
======================  ========================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from pathlib import Path

import numpy as np

from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.files import write_arrays, write_json
from gva_mi.core.stamp import write_record
from gva_mi.data.film import write_film
from gva_mi.data.fingerprint import SYNTH, fingerprint
from gva_mi.data.folder import TRUTH, VIDEO, SubjectWriter
from gva_mi.data.ground_truth import BODY
from gva_mi.data.splits import Splits
from gva_mi.splat import Camera
from gva_mi.synthetic import motion
from gva_mi.synthetic.cameras import camera_around
from gva_mi.synthetic.closest import Closest, closest
from gva_mi.synthetic.estimates import PictureErrors, Pipeline
from gva_mi.synthetic.options import FILM, MOTION, NOVEL_POSE, NOVEL_VIEW, RENDER, SynthOptions
from gva_mi.synthetic.pictures import Render, RenderJob, rendering
from gva_mi.synthetic.provenance import SURFACE, write_surface
from gva_mi.synthetic.render import Moment
from gva_mi.synthetic.rooms.phone import write_phone_film
from gva_mi.synthetic.staging import Staging, lowered


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
    views = min(options.novel_views, options.frames)
    total, done = options.frames + options.novel_poses + views, count(1)
    drawn_on = options.drawn_on(body)
    subject = options.subject_on(drawn_on)
    staging = Staging(options, drawn_on, subject)
    with (
        atomic_dir(Path(out), replaced) as folder,
        rendering(subject, staging.room(), options.light, options.workers) as rendered,
    ):

        def render(jobs: Iterable[RenderJob]) -> Iterator[np.ndarray]:
            for result in rendered(jobs):
                if progress is not None:
                    progress(next(done), total)
                yield result

        recording = _Recording(staging, body, render)
        recording.write_video(folder)
        recording.write_novel_poses(folder / TRUTH / "novel_pose")
        seen = recording.write_novel_views(folder / TRUTH / "novel_view", views)
        splits = Splits.every(options.frames).to_json()
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        SubjectWriter(folder).splits(splits)
        write_surface(folder / SURFACE, subject)
        about = {"options": options.recorded(), "seed": options.seed, "body": fingerprint(body)}
        write_record(folder / SYNTH, about)


@dataclass(frozen=True)
class _Recording:
    staging: Staging
    fitted: BodyModel  # of the estimated poses
    render: Render

    def _closest(self, pose: Pose) -> Closest:
        """Return the ground truth on the fitted body."""
        return closest(self.fitted, self.staging.body, pose, self.staging.subject.shape)

    def _jobs(
        self,
        folder: Path,
        exposures: Iterable[tuple[Moment, ...]],
        stream: int,
        errors: Sequence[PictureErrors] = (),
    ) -> Iterator[RenderJob]:
        """Yield the render job of each frame, which is random by stream and frame alone.

        Without ``errors``, one per frame, only the ground truth is written, without the room.
        """
        options = self.staging.options
        for k, moments in enumerate(exposures):
            seed = (*options.entropy(RENDER), stream, k)
            of_frame = errors[k] if errors else None
            yield RenderJob(folder, k, moments, options.samples, seed, of_frame)

    def write_video(self, folder: Path) -> None:
        """Write frames, masks, normals, cameras and poses of the video, with ground truth."""
        options, staging = self.staging.options, self.staging
        pose, cameras = staging.poses[0], staging.cameras
        truth = SubjectWriter(folder).truth
        truth.cameras(cameras)
        truth.poses(pose, staging.subject.shape, stage=0)
        if staging.body is not self.fitted:
            write_arrays(truth.folder / BODY, **staging.body.arrays())
        pipeline = Pipeline(options, self.fitted, cameras, self._closest(pose))
        jobs = self._jobs(folder, staging.exposures(), MOTION, pipeline.pictures())
        colors = list(self.render(jobs))
        write_film(folder / VIDEO, colors)
        if options.scene == "room":
            fps = Fraction(options.frames) / Fraction(motion.DURATION)
            write_phone_film(folder / "film.mp4", colors, fps, options.random(FILM))
            write_json(truth.folder / "film.json", staging.about_film())
        pipeline.write(folder)

    def write_novel_poses(self, folder: Path) -> None:
        """Write poses that the video does not hold, with their pictures."""
        options, staging = self.staging.options, self.staging
        if options.novel_poses == 0:
            return
        expressions, rng = staging.body.num_expressions, options.random(NOVEL_POSE)
        pose = motion.novel(options.novel_poses, expressions, rng)  # static: nothing lags behind
        pose = lowered(pose, staging.points(pose)[..., 1].min(1))
        cameras = [camera_around(points, options.size) for points in staging.points(pose)]
        self._write_truth(folder, [pose], cameras, NOVEL_POSE)

    def write_novel_views(self, folder: Path, views: int) -> list[int]:
        """Write some frames of the video from other sides and heights; return which."""
        if views == 0:
            return []
        options, staging = self.staging.options, self.staging
        rng = options.random(NOVEL_VIEW)
        seen = [k * options.frames // views for k in range(views)]
        poses = [pose[seen] for pose in staging.poses]
        cameras = []
        for points in staging.points(poses[0]):
            azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
            elevation = rng.uniform(-0.05, 0.45)
            cameras.append(camera_around(points, options.size, azimuth, elevation))
        self._write_truth(folder, poses, cameras, NOVEL_VIEW)
        return seen

    def _write_truth(
        self, folder: Path, poses: list[Pose], cameras: list[Camera], stream: int
    ) -> None:
        """Write exact pictures, masks, normals, cameras and poses."""
        for _ in self.render(self._jobs(folder, self.staging.still(poses, cameras), stream)):
            pass
        writer, near = SubjectWriter(folder), self._closest(poses[0])  # on the fitted body
        writer.cameras(cameras)
        writer.poses(near.pose, near.shape, stage=0)
