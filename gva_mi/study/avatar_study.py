"""The avatar study: every variant of the method is fitted to every case.

It has three rounds: the videos of the cases are made, the poses of each case are refined, and each
variant of each case is fitted and measured. If it is killed, only the steps since the last
checkpoint of a fit are lost.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.core.stamp import RESULTS_VERSIONS, is_fresh, write_record
from gva_mi.core.tasks import Task
from gva_mi.evaluate.figures import Figure
from gva_mi.evaluate.measure import measure_run
from gva_mi.evaluate.refinement import write_refinement
from gva_mi.fit.options import FitOptions
from gva_mi.fit.paper import REFINE
from gva_mi.fit.train import fit
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Study
from gva_mi.study.refine_study import refine_case
from gva_mi.study.variants import AvatarVariant
from gva_mi.study.videos import VideoOptions, Work, nudged, repeated
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.folder import POSES, REFINED_POSES
from gva_mi.subject.ground_truth import load_ground_truth
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import Video, load_video
from gva_mi.synthetic.errors.closest_pose import closest
from gva_mi.synthetic.options import NovelPictures, VideoFrames

PRINTED_POSES = "poses_printed.npz"  # in a case's folder, refined by Eq. 8 as printed
REFINED_WITH = "prepared.json"  # in a case's folder: what its refined poses were made with
MADE_WITH = "made_with.json"  # in a run's folder


@options_of("study")
class AvatarStudyOptions(VideoOptions):
    """Size of the avatar study."""

    frames: VideoFrames = 80  # frames of each video
    steps: Annotated[int, Within(1, 1_000_000)] = 3000  # steps of each fit
    novel: NovelPictures = 8  # pictures of novel poses, and as many of novel views
    fitted: bool = True  # also score under poses that are fitted to the pictures, which takes long
    refine: PythonOnly[SequenceOptions] = field(default_factory=SequenceOptions)
    fit: PythonOnly[FitOptions] = field(default_factory=FitOptions)  # but for its steps and seed


@dataclass(frozen=True)
class AvatarStudy(Study):
    """A study whose variants are ways to make an avatar."""

    options: AvatarStudyOptions
    rows: Sequence[AvatarVariant]
    kind = "avatar"

    @property
    def variants(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(variant.name for variant in self.rows)

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """As of any study, and the version of the refinement: avatars begin with its poses."""
        return super().made_with | {"refine_version": RESULTS_VERSIONS["refine"]}

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Make the videos of the cases, refine each case, then fit each variant."""
        cases = list(dict.fromkeys(case for case, _ in missing))
        of, given = self.videos.subject, (self.body, self.options.refine, self.stamp)
        refined = {row.name for row in self.rows if row.poses == "refined"}
        used = dict.fromkeys(case for case, variant in missing if variant in refined)
        prepared = [Work(partial(prepare_case, of(case), case, *given)) for case in used]
        runs = range(self.options.repeats)
        fitted = [
            Work(partial(repeated, [self.run(case, variant, k).solve for k in runs]))
            for case, variant in missing
        ]
        return [self.videos.work(cases, self.body), prepared, fitted]

    def run(self, case: StudyCase, variant: str, number: int = 0) -> VariantRun:
        """Return a run of a variant; the case's folder must exist before it is solved."""
        (row,) = (row for row in self.rows if row.name == variant)
        name = file_name(variant) + (f"-run-{number}" if number else "")
        out = self.folder / "runs" / file_name(case.name) / name
        options = replace(self.options.fit, seed=case.draw, steps=self.options.steps)
        options = options.of_video() if case.noise == VIDEO_KIND else options
        filmed = f"-video{RESULTS_VERSIONS['video']}" if case.noise == VIDEO_KIND else ""
        about = (self.body, options, self.stamp + filmed, self.options.fitted, number)
        return VariantRun(self.videos.subject(case), out, row, *about)


def file_name(name: str) -> str:
    """Return the folder's name of a case or variant."""
    return re.sub(r"\W+", "-", name).strip("-")


def prepare_case(
    subject: Path,
    case: StudyCase,
    body: BodyModel,
    options: SequenceOptions,
    stamp: str,
    progress: Progress | None = None,
) -> None:
    """Write refined poses into a case's folder, unless it has some of the same options."""
    if not is_fresh(subject / REFINED_WITH, stamp):
        write_refinement(refine_case(subject, case, body, options, progress=progress))
        (subject / PRINTED_POSES).unlink(missing_ok=True)
        write_record(subject / REFINED_WITH, {}, stamp)


@dataclass(frozen=True)
class VariantRun:
    """Fit one variant to one case, and measure it."""

    subject: Path  # the case's folder, refined
    out: Path  # the run's folder
    variant: AvatarVariant
    body: BodyModel
    options: FitOptions  # of the study; the variant changes them
    stamp: str  # of the study
    fitted: bool = True  # also score under fitted poses
    number: int = 0  # changes one ulp: :func:`gva_mi.study.videos.nudged`

    def solve(self, progress: Progress | None = None) -> tuple[Figure, ...]:
        """Fit, or resume a fit, and return its figures."""
        avatar, video = self.fit(progress)
        return measure_run(
            self.out, avatar, video, self.variant.name, self.body, self._poses,
            driven=self.driven(video),
            # fitted poses would bend a rigid body
            fit_to_pictures=self.fitted and not self.variant.rigid,
        ).figures  # fmt: skip

    def fit(self, progress: Progress | None = None) -> tuple[Avatar, Video]:
        """Fit, or resume a fit; return the avatar, and the video that it was fitted to."""
        self._make_room()
        if self.variant.poses == "printed" and not self._poses.exists():
            found = refine(load_video(self.subject), self.body, REFINE)
            save_poses(self._poses, found.pose, found.shape, stage=2)
        video, options = self.video(), self.variant.of(self.options)
        offsets = video.offsets_of(len(self.body.v_template))
        avatar = fit(
            video, self.body, options, self.out, offsets=offsets, resume=True, progress=progress
        )
        return avatar, video

    def video(self) -> Video:
        """Open the case's video under the poses that this variant is fitted with."""
        video = nudged(load_video(self.subject, self._poses), self.number)
        if self.variant.one_range:
            splits = Splits.one_range(len(video)).without(video.absent)
            video = replace(video, splits=splits)
        if self.variant.rigid:
            return replace(video, pose=self.driven(video)(video.pose))
        if self.variant.poses != "true":
            return video
        truth = load_ground_truth(video.truth, self.body)
        near = closest(self.body, truth.body, truth.pose, truth.shape)
        true = replace(video, pose=near.pose, shape=near.shape, cameras=truth.cameras)
        return nudged(true, self.number)

    def driven(self, video: Video) -> Callable[[Pose], Pose]:
        """Return the function applied to every pose before it drives the avatar."""
        if not self.variant.rigid:
            return lambda pose: pose
        joints = video.pose.rotations[video.splits.train[0], 1:]

        def rigid(pose: Pose) -> Pose:
            rotations = pose.rotations.clone()
            rotations[:, 1:] = joints
            return replace(pose, rotations=rotations)

        return rigid

    @property
    def _poses(self) -> Path:
        others = {"stage 1": POSES, "printed": PRINTED_POSES}
        return self.subject / others.get(self.variant.poses, REFINED_POSES)

    def _make_room(self) -> None:
        """Remove a run that was made with other inputs."""
        held = self.out / MADE_WITH
        if self.out.exists() and not is_fresh(held, self.stamp):
            shutil.rmtree(self.out)
        if not held.exists():
            write_record(held, {}, self.stamp)
