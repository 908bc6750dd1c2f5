"""The videos of a study: a subject is rendered once, and each error model degrades a copy.

The error model "video" is the real one: networks and stage 1 see the pictures. The poses of
:mod:`gva_mi.stage1` stand in a world of their own. They are brought to the world of the ground
truth: the camera sees the same, and errors can be measured.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix, to_rotvec
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.files import write_json
from gva_mi.core.options import PictureSide, PythonOnly, Within, options_of
from gva_mi.core.stamp import RESULTS_VERSIONS
from gva_mi.evaluate.figures import Figure, mean_of_runs
from gva_mi.matting.masks import video_masks
from gva_mi.splat import Camera
from gva_mi.stage1.prepare import PrepareVideoOptions, motion_of_video
from gva_mi.study.cases import StudyCase, Take
from gva_mi.subject.fingerprint import VIDEO_KIND, require_same_body
from gva_mi.subject.folder import PREPARED, SPLITS, SYNTH, TRUTH, SubjectWriter
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.pictures import in_8_bits
from gva_mi.subject.video import Video
from gva_mi.synthetic import degrade, make_subject
from gva_mi.synthetic.options import NovelPictures, VideoFrames

ALL_FPS = 240.0  # pictures a second; chosen: more than any of these videos has, so all are used


class Work(NamedTuple):
    """A piece of a study's work: a Task. The progress bar counts all pieces alike."""

    call: Callable[..., Any]  # a partial function that can be pickled; takes ``progress``
    steps: int = 100

    def solve(self, progress: Progress | None = None) -> Any:  # noqa: ANN401
        """Do the work in this process."""
        return self.call(progress=progress)


@options_of("study")
class VideoOptions:
    """Size of the videos of a study."""

    frames: VideoFrames = 64  # frames of each video
    size: PictureSide = 512  # pixels, width and height of the pictures
    # Error model video: the focal length is given, as most phones record it.
    lens: bool = True
    novel: PythonOnly[NovelPictures] = 0  # pictures of novel poses, and as many of novel views
    # Runs of each variant, whose inputs differ by one float32 ulp: the spread of chance alone.
    repeats: Annotated[int, Within(1, 100)] = 1


def nudged(video: Video, run: int) -> Video:
    """Change the first pose's place of a training frame by one float32 ulp; not in run 0."""
    if not run:
        return video
    train, transl = video.splits.train, video.pose.transl.clone()
    x = transl[train[(run - 1) % len(train)], :1]
    x.copy_(torch.nextafter(x, torch.full_like(x, torch.inf)))
    return replace(video, pose=replace(video.pose, transl=transl))


def repeated(
    runs: Sequence[Callable[..., Sequence[Figure]]], progress: Progress | None = None
) -> list[Figure]:
    """Call functions that measure the same but for one ulp; return means and spreads."""
    parts = [part_of_progress(progress, k, 1, len(runs)) for k in range(len(runs))]
    return mean_of_runs([run(progress=part) for run, part in zip(runs, parts, strict=True)])


@dataclass(frozen=True)
class StudyVideos:
    """The videos of a study in its folder."""

    folder: Path
    options: VideoOptions

    def subject(self, case: StudyCase) -> Path:
        """Return the folder of a case's video, existing or not.

        A video's masks and poses are results of this program, so its folder names their version.
        """
        made = case.noise
        if made == VIDEO_KIND:
            made += f"{RESULTS_VERSIONS['video']}{'' if self.options.lens else '-anylens'}"
        return self.folder / "videos" / f"{self._name(case.take)}-{made}-{case.draw}"

    def make(
        self, cases: Sequence[StudyCase], body: BodyModel, progress: Progress | None = None
    ) -> None:
        """Make the missing videos of the given cases."""
        for case in cases:
            take, subject = self.folder / "takes" / self._name(case.take), self.subject(case)
            options = self.options
            if not take.exists():
                made = case.take.synth(options.frames, options.size, options.novel)
                make_subject(take, made, body)
            if not subject.exists() and case.noise == VIDEO_KIND:
                watch_take(take, subject, body, options.lens)
            elif not subject.exists():
                degrade(take, subject, case.noise, case.draw, body)
            require_same_body(subject, body)

    def work(self, cases: Iterable[StudyCase], body: BodyModel) -> list[Work]:
        """Return the work of making cases, a piece for each take, so no two workers render it."""
        cases = list(dict.fromkeys(cases))
        takes = dict.fromkeys(case.take for case in cases)
        several = ([case for case in cases if case.take == take] for take in takes)
        return [Work(partial(self.make, of_take, body)) for of_take in several]

    def _name(self, take: Take) -> str:
        frames, size = take.frames or self.options.frames, take.size or self.options.size
        name = take.name.replace(", ", "-").replace(" ", "")
        return f"{name}-{frames}-{size}-novel{self.options.novel}"


def watch_take(take: Path, out: Path, body: BodyModel, lens: bool = True) -> None:
    """Write a copy of a synthetic subject with what its video gives: pictures, masks and poses.

    The video is the compressed one, ``phone.mp4``; the steps are the same as in ``gva-mi prepare
    video``. The height is known. A hand-held camera is treated as standing, as in any video: the
    true poses become the poses that the first camera would have to see.

    Args:
        take: a folder that ``gva-mi synth --scene room`` made.
        out: the new folder, which must not exist; it appears when it is complete.
        body: the body that the poses move.
        lens: whether the focal length is known, as most phones record it; else it is found.
    """
    truth = load_ground_truth(take / TRUTH, body)
    camera = truth.cameras[0]
    with atomic_dir(out) as folder:
        writer = SubjectWriter(folder)
        shutil.copytree(take / TRUTH, folder / TRUTH)
        for name in (SPLITS, SYNTH):
            if (take / name).exists():
                shutil.copy2(take / name, folder / name)
        if any((other.T_camera_world != camera.T_camera_world).any() for other in truth.cameras):
            writer.truth.poses(steadied(truth), truth.shape, stage=2)
            writer.truth.cameras([camera] * len(truth.cameras))
        seen: dict[int, np.ndarray] = {}
        motion = motion_of_video(
            take / "phone.mp4",
            PrepareVideoOptions(height=height_of(truth), fps=ALL_FPS),
            body,
            lens=str(camera.fx) if lens else None,
            on_silhouette=lambda k, silhouette: seen.update({k: in_8_bits(silhouette)}),
        )
        pictures, solved = motion.pictures.pictures, motion.solved
        for k, picture in enumerate(pictures):
            writer.frame(k, picture)
        probabilities = [seen[k] for k in range(len(pictures))]
        video_masks(pictures, probabilities, motion.watched.landmarks, writer)
        writer.landmarks(motion.watched.landmarks)
        pose = moved(solved.pose, solved.shape, body, solved.camera, camera)
        writer.poses(pose, solved.shape, stage=1)
        if not lens:  # beside the estimate that the subject has
            writer.truth.cameras([camera] * len(pictures))
        found = camera if lens else camera.zoomed(solved.camera.fx / camera.fx)
        writer.cameras([found] * len(pictures))
        write_json(folder / PREPARED, {"kind": VIDEO_KIND, "video": {"fps": motion.pictures.fps}})


def moved(pose: Pose, shape: Shape, body: BodyModel, before: Camera, after: Camera) -> Pose:
    """Return poses that one camera sees where another one saw the given poses."""
    T = torch.from_numpy(np.linalg.inv(after.T_camera_world) @ before.T_camera_world)
    R, t = T[:3, :3].to(pose.transl), T[:3, 3].to(pose.transl)
    pelvis, rotations = body.rest(shape).joints[0], pose.rotations.clone()
    rotations[:, 0] = to_rotvec(R @ to_matrix(rotations[:, 0]))
    return Pose(rotations, (pelvis + pose.transl) @ R.T + t - pelvis, pose.expression)


def steadied(truth: GroundTruth) -> Pose:
    """Return poses that the first camera would have to see, to see what each frame's camera saw."""
    frames = [
        moved(truth.pose[[k]], truth.shape, truth.body, camera, truth.cameras[0])
        for k, camera in enumerate(truth.cameras)
    ]
    return Pose.cat(frames)


def height_of(truth: GroundTruth) -> float:
    """Return the subject's height at rest, from head to soles, metres."""
    y = truth.body.rest(truth.shape).vertices[:, 1]
    return float(y.max() - y.min())
