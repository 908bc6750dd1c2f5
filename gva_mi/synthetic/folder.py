"""A subject's folder: the video that a real pipeline would have, and its ground truth.

:func:`make_subject` writes one, :func:`degrade` copies one with other errors,
:func:`remake_subject` makes its person again, and :func:`relit_pictures` shows it in other light.

Pictures are sRGB-encoded, the person on white or in a room (see ``render``); held-out ones are on
white, in the light of the room. ``phone.mp4`` is the video that a phone would make in a room.

Files outside ``truth`` are estimates of a pipeline (see ``errors/pipeline``), cameras included,
whose focal length may be wrong. All in ``truth`` is exact:

======================  ========================================================================
``poses.npz``           poses of the body that was drawn
``body.npz``            this body, if it is not the fitted one, see ``person/bodies``
``cameras.npz``         the true cameras
``masks``, ``normals``  of the video
``novel_view``          frames of the video from other sides; ``splits.json`` lists them
``novel_pose``          poses that the video does not hold
``person.json``         height of the person, for a video in a room
======================  ========================================================================

A picture depends only on its :class:`RenderJob`: one process computes all surfaces, and every job
has its own random numbers, so any number of worker processes writes the same bits.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json, write_arrays, write_json
from gva_mi.core.tasks import helper_processes
from gva_mi.splat import Camera
from gva_mi.subject.fingerprint import fingerprint, require_same_body
from gva_mi.subject.folder import FRAMES, SPLITS, SYNTH, TRUTH, VIDEO, SubjectWriter
from gva_mi.subject.ground_truth import TRUE_BODY, load_ground_truth
from gva_mi.subject.splits import Splits
from gva_mi.subject.video_file import write_video
from gva_mi.synthetic.errors.closest_pose import Closest, closest
from gva_mi.synthetic.errors.pipeline import (
    PictureErrors,
    Pipeline,
    write_estimates,
    write_pictures,
)
from gva_mi.synthetic.motion import motions
from gva_mi.synthetic.options import SubjectStream, SynthOptions
from gva_mi.synthetic.person.surface import PersonSurface
from gva_mi.synthetic.pictures.cameras import PHONE_VIDEO, camera_around, write_phone_video
from gva_mi.synthetic.pictures.render import Moment, Renderer, Rendering
from gva_mi.synthetic.staging import Staging, lowered


@dataclass(frozen=True)
class RenderJob:
    """One picture to render."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    moments: tuple[Moment, ...]  # of the exposure
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # seed of its random numbers
    # With errors, the ground truth is written into truth/, and the room, if there is one, is shown.
    errors: PictureErrors | None = None


Render = Callable[[Iterable[RenderJob]], Iterator[np.ndarray]]  # 8-bit pictures (H, W, 3)


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
    drawn_on, shared = options.drawn_on(body), options.workers > 1
    # The processes start while the subject is drawn.
    with (
        atomic_dir(Path(out), replaced) as folder,
        helper_processes(options.workers + 1, shared) as helpers,
    ):
        subject = options.subject_on(drawn_on)
        staging = Staging(options, drawn_on, subject)
        renderer = partial(Renderer, subject, staging.room(), options.light)
        if shared:
            draw = helpers.in_order(_make_render, renderer)
        else:
            draw = partial(map, partial(_render_job, renderer()))

        def render(jobs: Iterable[RenderJob]) -> Iterator[np.ndarray]:
            for result in draw(jobs):
                if progress is not None:
                    progress(next(done), total)
                yield result

        contents = _SubjectContents(staging, body, render)
        contents.write_video(folder)
        contents.write_novel_poses(folder / TRUTH / "novel_pose")
        seen = contents.write_novel_views(folder / TRUTH / "novel_view", views)
        splits = Splits.every(options.frames).to_json()
        splits |= {"novel_pose": list(range(options.novel_poses)), "novel_view": seen}
        SubjectWriter(folder).splits(splits)
        about = {"options": options.recorded(), "seed": options.seed, "body": fingerprint(body)}
        SubjectWriter(folder).record(SYNTH, about)


def degrade(subject: Path, out: Path, error_model: str, seed: int, body: BodyModel) -> None:
    """Copy a subject with other errors, so that each person is rendered once.

    The folder appears when it is complete. It equals what :func:`make_subject` makes with this
    error model and ``error_seed``; earlier errors have no effect. Only ``bursts`` degrades normals
    as rendered: from files, they are up to one grey level off. Frames and ground truth are
    hard-linked from the old folder if the disk allows it.

    Args:
        subject: a folder that :func:`make_subject` or this function made.
        out: the new folder, which must not exist or be empty.
        error_model, seed: the error model, and the seed of its errors.
        body: the body that the subject was made on.

    Raises:
        InputError: ``out`` holds something else, ``subject`` was not made here or on another body,
            or there is no such error model.
    """
    subject = Path(subject)
    about, options = recorded_options(subject)
    require_same_body(subject, body)
    options = replace(options, error_model=error_model, error_seed=seed)
    truth = load_ground_truth(subject / TRUTH, body)
    near = closest(body, truth.body, truth.pose, truth.shape)
    pipeline = Pipeline(options, body, truth.cameras, near)
    with atomic_dir(Path(out)) as folder:
        for name in (VIDEO, PHONE_VIDEO, FRAMES, TRUTH, SPLITS):
            if (subject / name).is_dir():
                shutil.copytree(subject / name, folder / name, copy_function=_link)
            elif (subject / name).exists():
                _link(subject / name, folder / name)
        for k, errors in enumerate(pipeline.pictures()):
            write_estimates(folder, k, errors, options.samples)
        pipeline.write(folder)
        write_json(folder / SYNTH, about | {"options": options.recorded()})


def remake_subject(subject: Path, body: BodyModel) -> tuple[PersonSurface, BodyModel]:
    """Make the person of a folder again, with materials and binding, and the body drawn on.

    ``body`` is the one of its stage-1 poses.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``, or on another body.
    """
    require_same_body(subject, body)
    _, options = recorded_options(subject)
    drawn_on = options.drawn_on(body)
    return options.subject_on(drawn_on), drawn_on


def relit_pictures(
    subject: Path, body: BodyModel, light: str, frames: Sequence[int]
) -> list[Rendering]:
    """Render some frames of a subject's video again, under another light.

    They are those of ``gva-mi synth --light``, before rounding to 8 bits, of the same person.

    Args:
        subject: a folder that :func:`make_subject` or :func:`degrade` made, on white and with a
            shutter that does not blur.
        body: of its stage-1 poses.
        light: one of :data:`gva_mi.synthetic.pictures.lights.LIGHTS`.
        frames: of the video.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``, or in a room, or on another body.
    """
    surface, drawn_on = remake_subject(subject, body)
    options = recorded_options(subject)[1]
    if options.scene != "white" or options.shutter > 0:
        raise InputError(f"{subject}: only a sharp subject on white can be rendered in other light")
    staging, renderer = Staging(options, drawn_on, surface), Renderer(surface, None, light)
    poses, cameras = [pose[list(frames)] for pose in staging.poses], staging.cameras
    still = staging.still(poses, [cameras[k] for k in frames])
    seeds = ((*options.entropy(SubjectStream.RENDER), SubjectStream.MOTION, k) for k in frames)
    return [
        renderer.expose(moments, options.samples, _picture_seed(seed))
        for moments, seed in zip(still, seeds, strict=True)
    ]


def recorded_options(subject: Path) -> tuple[dict, SynthOptions]:
    """Read a subject's ``synth.json`` and the options in it.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``.
    """
    path, expected = subject / SYNTH, "a folder that gva-mi synth made"
    about = read_json(path, expected)
    with expecting(path, expected):
        return about, SynthOptions(**about["options"])


@dataclass(frozen=True)
class _SubjectContents:
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
            seed = (*options.entropy(SubjectStream.RENDER), stream, k)
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
            write_arrays(truth.folder / TRUE_BODY, **staging.body.arrays())
        pipeline = Pipeline(options, self.fitted, cameras, self._closest(pose))
        jobs = self._jobs(folder, staging.exposures(), SubjectStream.MOTION, pipeline.pictures())
        colors = list(self.render(jobs))
        write_video(folder / VIDEO, colors)
        if options.scene == "room":
            fps = Fraction(options.frames) / Fraction(motions.ROUND_SECONDS)
            rng = options.random(SubjectStream.PHONE_VIDEO)
            write_phone_video(folder / PHONE_VIDEO, colors, fps, rng)
            write_json(truth.folder / "person.json", {"height_m": staging.height})
        pipeline.write(folder)

    def write_novel_poses(self, folder: Path) -> None:
        """Write poses that the video does not hold, with their pictures."""
        options, staging = self.staging.options, self.staging
        if options.novel_poses == 0:
            return
        expressions, rng = staging.body.num_expressions, options.random(SubjectStream.NOVEL_POSE)
        pose = motions.novel(options.novel_poses, expressions, rng)  # static: nothing lags behind
        pose = lowered(pose, staging.points(pose)[..., 1].min(1))
        cameras = [camera_around(points, options.size) for points in staging.points(pose)]
        self._write(folder, [pose], cameras, SubjectStream.NOVEL_POSE)

    def write_novel_views(self, folder: Path, views: int) -> list[int]:
        """Write some frames of the video from other sides and heights; return which."""
        if views == 0:
            return []
        options, staging = self.staging.options, self.staging
        rng = options.random(SubjectStream.NOVEL_VIEW)
        seen = [k * options.frames // views for k in range(views)]
        poses = [pose[seen] for pose in staging.poses]
        cameras = []
        for points in staging.points(poses[0]):
            azimuth = rng.choice([-1, 1]) * rng.uniform(0.4, 2.6)
            elevation = rng.uniform(-0.05, 0.45)
            cameras.append(camera_around(points, options.size, azimuth, elevation))
        self._write(folder, poses, cameras, SubjectStream.NOVEL_VIEW)
        return seen

    def _write(self, folder: Path, poses: list[Pose], cameras: list[Camera], stream: int) -> None:
        """Write exact pictures, masks, normals, cameras and poses."""
        for _ in self.render(self._jobs(folder, self.staging.still(poses, cameras), stream)):
            pass
        writer, near = SubjectWriter(folder), self._closest(poses[0])  # on the fitted body
        writer.cameras(cameras)
        writer.poses(near.pose, near.shape, stage=0)


def _make_render(make: Callable[[], Renderer]) -> Callable[[Iterable[RenderJob]], list[np.ndarray]]:
    """Return a function that renders jobs and writes their files, with a renderer of its own."""
    renderer = make()
    return lambda jobs: [_render_job(renderer, job) for job in jobs]


def _render_job(renderer: Renderer, job: RenderJob) -> np.ndarray:
    """Render one picture and write its files; return its colour, 8-bit (H, W, 3)."""
    samples, errors = job.samples // len(job.moments), job.errors
    seed = _picture_seed(job.seed)
    true = renderer.expose(job.moments, samples, seed, shown=errors is not None)
    stored = np.round(true.color * 255).astype(np.uint8)
    SubjectWriter(job.folder).frame(job.index, stored)
    exact = job.folder if errors is None else job.folder / TRUTH
    write_pictures(exact, job.index, true.mask, true.normals)
    if errors is not None:
        rendered = (true.mask, true.normals) if errors.as_rendered else None
        write_estimates(job.folder, job.index, errors, job.samples, rendered)
    return stored


def _picture_seed(seed: tuple[int, ...]) -> int:
    """Return the renderer's seed of a picture, from the seed of its job."""
    random, _ = np.random.SeedSequence(seed).spawn(2)  # the second is for the errors
    return int(random.generate_state(1)[0])


def _link(source: Path | str, target: Path | str) -> None:
    """Hard-link a file, or copy it where links are not possible."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
