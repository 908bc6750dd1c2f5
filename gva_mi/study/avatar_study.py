"""The avatar study: every variant (:mod:`gva_mi.study.variants`) is fitted to every case.

Work is done in three rounds: takes are filmed, the poses of each case are refined, and each variant
of each case is fitted and measured. A run is kept in ``runs/CASE/VARIANT/``, in the form of
:mod:`gva_mi.fit.run_folder`: if the study is killed, only the steps since the last checkpoint are
lost, and the page can show the avatar.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import PictureSide, options_of
from gva_mi.core.stamp import RESULTS_VERSIONS, is_fresh, write_record
from gva_mi.core.tasks import Task
from gva_mi.data.fingerprint import FILM
from gva_mi.data.folder import POSES, REFINED_POSES
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.data.splits import Splits
from gva_mi.data.video import Video, load_video
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions
from gva_mi.fit.paper import REFINE
from gva_mi.fit.photometric import FITTED
from gva_mi.fit.train import fit
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Study, Work
from gva_mi.study.fitted_poses import with_fitted_poses
from gva_mi.study.metrics import ALIGNED, AS_REFINED, Metrics, measure_run, save_metrics
from gva_mi.study.pictures import ShownAvatar
from gva_mi.study.refine_study import refine_case
from gva_mi.study.refinement import write_refinement
from gva_mi.study.subjects import Filming, filming_work
from gva_mi.study.variants import AvatarVariant
from gva_mi.synthetic.closest import closest
from gva_mi.synthetic.options import NovelPictures, VideoFrames

PRINTED_POSES = "poses_printed.npz"  # in a case's folder, refined by Eq. 8 as printed
PREPARED = "prepared.json"  # in a case's folder: what its refined poses were made with
REFINE_STEPS = 1000  # of a case, in steps of a fit, for the progress bar
MADE_WITH = "made_with.json"  # in a run's folder


@options_of("study")
class AvatarStudyOptions:
    """Size of the study."""

    frames: VideoFrames = 80  # frames of each video
    size: PictureSide = 512  # pixels, width and height of the pictures
    novel: NovelPictures = 8  # pictures of novel poses, and as many of novel views
    lens: bool = True  # of films, the focal length is given, as most phones record it
    refine: SequenceOptions = field(default_factory=SequenceOptions)
    fit: FitOptions = field(default_factory=FitOptions)


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

    @property
    def _filming(self) -> Filming:
        options = self.options
        return Filming(self.folder, options.frames, options.size, options.novel, options.lens)

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Film the takes, refine each case, then fit each variant."""
        cases, filming = dict.fromkeys(case for case, _ in missing), self._filming
        also_printed = any(row.poses == "printed" for row in self.rows)
        made = self.body, self.options.refine, self.stamp, also_printed
        prepared = [
            Work(REFINE_STEPS, partial(prepare_case, filming.subject(case), case, *made))
            for case in cases
        ]
        films = filming_work(filming, cases, self.body)
        return [films, prepared, [self.run(*pair) for pair in missing]]

    def run(self, case: StudyCase, variant: str) -> VariantRun:
        """Return the run of a variant; the case's folder must exist before it is solved."""
        (row,) = (row for row in self.rows if row.name == variant)
        out = self.folder / "runs" / file_name(case.name) / file_name(variant)
        options = replace(self.options.fit, seed=case.draw)
        options = options.of_film() if case.noise == FILM else options
        return VariantRun(self._filming.subject(case), out, row, self.body, options, self.stamp)


def file_name(name: str) -> str:
    """Return the folder's name of a case or variant."""
    return re.sub(r"\W+", "-", name).strip("-")


def prepare_case(
    subject: Path,
    case: StudyCase,
    body: BodyModel,
    options: SequenceOptions,
    stamp: str,
    also_printed: bool,
    progress: Progress | None = None,
) -> None:
    """Write refined poses into a case's folder, unless it has those of the same options.

    ``also_printed``: also the poses that Eq. 8 as printed finds.
    """
    if not is_fresh(subject / PREPARED, stamp):
        evaluation = refine_case(subject, case, body, options, progress=progress)
        write_refinement(evaluation)
        (subject / PRINTED_POSES).unlink(missing_ok=True)
        write_record(subject / PREPARED, {}, stamp)
    if also_printed and not (subject / PRINTED_POSES).exists():
        found = refine(load_video(subject), body, REFINE)
        save_poses(subject / PRINTED_POSES, found.pose, found.shape, stage=2)


@dataclass(frozen=True)
class VariantRun:
    """Fit one variant to one case, and measure it: a Task."""

    subject: Path  # the case's folder, refined
    out: Path  # the run's folder
    variant: AvatarVariant
    body: BodyModel
    options: FitOptions  # of the study; the variant changes them
    stamp: str  # of the study

    @property
    def steps(self) -> int:
        """Amount of work, for the progress bar."""
        return self.options.steps

    def solve(self, progress: Progress | None = None) -> dict[str, float | None]:
        """Fit, or resume a fit, and return the figures of the table."""
        self._make_room()
        video = self.video()
        offsets = video.offsets_of(len(self.body.v_template))
        avatar = fit(
            video, self.body, self.variant.of(self.options), self.out, offsets=offsets,
            resume=True, progress=progress,
        )  # fmt: skip
        args = (self.out, avatar, video, self.variant.name, self.body, self._poses)
        metrics = measure_run(*args, driven=self.driven(video))
        if not self.variant.rigid:  # fitted poses would bend a rigid body
            trained = run_folder.under_trained_poses(video, self.out)
            metrics = with_fitted_poses(metrics, avatar, video, trained, self.body)
        save_metrics(self.out, metrics)
        return columns(metrics)

    @property
    def is_done(self) -> bool:
        """Whether its avatar exists; figures may be kept without it."""
        return (self.out / run_folder.AVATAR).exists()

    def avatar(self) -> Avatar:
        """Load the finished avatar."""
        return run_folder.load_avatar(self.out)

    def shown(self) -> ShownAvatar:
        """Open the finished avatar and its splits for pictures."""
        video = self.video()
        trained = run_folder.under_trained_poses(video, self.out)
        return ShownAvatar.of(self.avatar(), trained, self.body, self.driven(video))

    def video(self) -> Video:
        """Open the case's video under the poses that this variant is fitted with."""
        video = load_video(self.subject, self._poses)
        if self.variant.one_range:
            splits = Splits.one_range(len(video)).without(video.absent)
            video = replace(video, splits=splits)
        if self.variant.rigid:
            return replace(video, pose=self.driven(video)(video.pose))
        if self.variant.poses != "true":
            return video
        truth = load_ground_truth(video.truth, self.body)
        near = closest(self.body, truth.body, truth.pose, truth.shape)
        return replace(video, pose=near.pose, shape=near.shape, cameras=truth.cameras)

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


ROWS_UNDER = {AS_REFINED: "as given", ALIGNED: "aligned", FITTED: "poses fitted"}


def columns(metrics: Metrics) -> dict[str, float | None]:
    """Return a run's metrics as columns of the study's tables (:mod:`gva_mi.study.tables`)."""
    figures: dict[str, float | None] = {
        "cost: seconds": metrics.training.seconds,
        "cost: Gaussians": float(metrics.training.gaussians),
    }
    for row in metrics.rows:
        if row.split == "train":
            continue
        where = row.split.replace("_", " ")
        if row.name in ROWS_UNDER:
            where += f", {ROWS_UNDER[row.name]}"
        if row.region != "white":
            figures[f"psnr in boxes: {where}, {row.region}"] = row.psnr
            continue
        for metric in ("psnr", "ssim", "lpips", "rand_vgg"):
            figures[f"{metric}: {where}"] = getattr(row, metric)
    for which, errors in metrics.poses_mm.items():
        for name in ("body", "body_aligned", "hands_aligned", "feet_aligned"):
            title = " ".join(reversed(name.split("_")))  # aligned body
            figures[f"pose error, mm: {title}, {which}"] = errors[name]
    for moment in metrics.surface:  # a later moment replaces an earlier one of its name
        for name, x in moment.figures.items():
            title, comma, unit = name.partition(", ")
            figures[f"surface: {title}, {moment.moment}{comma}{unit}"] = x
    return figures
