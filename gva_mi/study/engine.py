"""The two studies: cases x variants -> figures, kept in one file that is resumed.

The refinement study measures stage 2 on subjects and errors it was not tuned on. One camera hardly
determines a person's size, distance and focal length. The owner of a video may know them: with
:attr:`RefineStudyOptions.known`, height and focal length are the true ones.

The avatar study fits every variant to every case, in three rounds: takes are filmed, the poses of
each case are refined, and each variant of each case is fitted and measured. If it is killed, only
the steps since the last checkpoint of a fit are lost.

A study's folder holds::

    takes/, videos/     the subjects, made where they are missing
    KIND.json           {"kind", "made_with", "versions", "stamp", "cases": {name: case},
                         "figures": rows of gva_mi.evaluate.figures, whose subject is a case's name}
    KIND.html           the same as a page
    runs/CASE/VARIANT/  runs of the avatar study, in the form of gva_mi.fit.run_folder

A result is used again only if everything it depends on is the same: the options, the body, and the
results version of the study (:mod:`gva_mi.core.stamp`).
"""

from __future__ import annotations

import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

from gva_mi.body.pose import Pose, save_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import PythonOnly, Within, from_json, options_of
from gva_mi.core.stamp import RESULTS_VERSIONS, is_fresh, stamp, write_record
from gva_mi.core.tasks import Task, run
from gva_mi.evaluate.figures import Figure, figures_from, to_json
from gva_mi.evaluate.measure import measure_run
from gva_mi.evaluate.refinement import Evaluation, mask_iou, write_refinement
from gva_mi.evaluate.similarity import zoomed
from gva_mi.fit.options import FitOptions
from gva_mi.fit.paper import REFINE
from gva_mi.fit.train import fit
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.study.cases import AvatarVariant, StudyCase
from gva_mi.study.filmed import Filming, VideoOptions, Work, height_of
from gva_mi.subject.fingerprint import VIDEO_KIND, fingerprint
from gva_mi.subject.folder import POSES, REFINED_POSES
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import Video, load_video
from gva_mi.synthetic.foreign_body import closest
from gva_mi.synthetic.options import NovelPictures, VideoFrames

EXPECTED = "what `gva-mi study` writes, or give --overwrite"

STAGE_1, REFINED = "stage 1", "refined"  # variants of the refinement study
PRINTED_POSES = "poses_printed.npz"  # in a case's folder, refined by Eq. 8 as printed
PREPARED = "prepared.json"  # in a case's folder: what its refined poses were made with
MADE_WITH = "made_with.json"  # in a run's folder


@dataclass(frozen=True)
class Outcome:
    """Figures of one variant for one case."""

    case: StudyCase
    variant: str
    figures: tuple[Figure, ...]

    @property
    def key(self) -> tuple[StudyCase, str]:
        """Identity of the outcome in its study."""
        return self.case, self.variant


@dataclass(frozen=True)
class Study(ABC):
    """The inputs of a study, and the file of its results."""

    folder: Path
    body: BodyModel  # that is fitted
    options: VideoOptions
    kind: ClassVar[str]  # names its files

    @property
    def filming(self) -> Filming:
        """Its videos."""
        return Filming(self.folder, self.options)

    @property
    @abstractmethod
    def variants(self) -> Sequence[str]:
        """Names of the ways that each case is computed."""

    @abstractmethod
    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Return work in rounds; each piece of the last one returns the figures of a pair."""

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """Options and version of the results, for the record."""
        version = RESULTS_VERSIONS[self.kind]
        return {"options": asdict(self.options), "results_version": version}

    @cached_property
    def stamp(self) -> str:
        """Stamp of all that a result depends on besides its case and variant."""
        return stamp(options=[self.kind, self.made_with, fingerprint(self.body)])

    @property
    def path(self) -> Path:
        """The file of the results."""
        return self.folder / f"{self.kind}.json"

    def load(self) -> list[Outcome]:
        """Read the results that still hold; none if there is no file.

        Raises:
            InputError: the file cannot be read.
        """
        if not self.path.exists():
            return []
        record = read_json(self.path, EXPECTED)
        with expecting(self.path, EXPECTED):
            if record["kind"] != self.kind or not is_fresh(self.path, self.stamp):
                return []
            cases = {name: from_json(StudyCase, case) for name, case in record["cases"].items()}
            found: dict[tuple[str, str], list[Figure]] = {}
            for figure in figures_from(record["figures"]):
                found.setdefault((figure.subject, figure.variant), []).append(figure)
            return [
                Outcome(cases[name], variant, tuple(figures))
                for (name, variant), figures in found.items()
            ]

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Write all results."""
        record = {"kind": self.kind, "made_with": self.made_with}
        record["cases"] = {outcome.case.name: asdict(outcome.case) for outcome in outcomes}
        record["figures"] = to_json(figure for outcome in outcomes for figure in outcome.figures)
        write_record(self.path, record, self.stamp)


def run_study(
    study: Study,
    cases: Sequence[StudyCase],
    known: Sequence[Outcome] = (),
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[Outcome]:
    """Yield the outcome of every case and variant, case by case, computing what is not known.

    Args:
        study: which gives the work.
        cases: such as HELD_OUT.
        known: outcomes that need not be computed.
        progress: called as ``progress(done, total)``.
        executor: runs the work, and must see the study's folder; None: this process.
    """
    done = {outcome.key: outcome for outcome in known}
    wanted = [(case, variant) for case in cases for variant in study.variants]
    *first, last = study.rounds([pair for pair in wanted if pair not in done])
    total, before = sum(work.steps for works in (*first, last) for work in works), 0
    for works in first:
        steps = sum(work.steps for work in works)
        for _ in run(works, executor, part_of_progress(progress, before, steps, total)):
            pass
        before += steps
    found = run(last, executor, part_of_progress(progress, before, total - before, total))
    for case, variant in wanted:
        if (case, variant) in done:
            yield done[case, variant]
        else:
            figures = next(found).result
            own = (replace(figure, subject=case.name, variant=variant) for figure in figures)
            yield Outcome(case, variant, tuple(own))


@options_of("study")
class RefineStudyOptions(VideoOptions):
    """Size of the refinement study."""

    known: bool = False  # the subject's height and the focal length are given
    refine: PythonOnly[SequenceOptions] = field(default_factory=SequenceOptions)


@dataclass(frozen=True)
class RefineStudy(Study):
    """A study of one variant: the refinement, or stage 1 as it is."""

    options: RefineStudyOptions
    variants: Sequence[str] = (REFINED,)
    kind = "refine"

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Video the takes, then refine each case."""
        measured = []
        for case, variant in missing:
            given = self.filming.subject(case), case, variant, self.body, self.options
            measured.append(Work(partial(refinement_figures, *given)))
        return [self.filming.work([case for case, _ in missing], self.body), measured]


def refinement_figures(
    subject: Path,
    case: StudyCase,
    variant: str,
    body: BodyModel,
    options: RefineStudyOptions,
    progress: Progress | None = None,
) -> list[Figure]:
    """Measure a case of the refinement study."""
    if variant == STAGE_1:
        video = load_video(subject, normals="none")
        truth = load_ground_truth(video.truth, body)
        found = Evaluation(video, body, options.refine, None, truth)
    else:
        found = refine_case(subject, case, body, options.refine, options.known, progress)
    return [*found.figures(), Figure(metric="mask IoU", value=mask_iou(found.video))]


def refine_case(
    subject: Path,
    case: StudyCase,
    body: BodyModel,
    options: SequenceOptions,
    known: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Refine and measure a case's video; ``known``: with the true height and focal length."""
    video = load_video(subject, normals=None if case.normals else "none")
    truth, options = load_ground_truth(video.truth, body), replace(options, seed=case.draw)
    if case.noise == VIDEO_KIND or known:  # the stage 1 of videos was given the height, too
        options = replace(options, height=height_of(truth))
    if not known:
        refined = refine(video, body, options, progress)
    else:
        focused = with_true_focal(truth, video, body)
        refined = replace(refine(focused, body, options, progress), cameras=focused.cameras)
    return Evaluation(video, body, options, refined, truth)


def with_true_focal(truth: GroundTruth, video: Video, body: BodyModel) -> Video:
    """Give a video the true focal length; its poses follow, as by ``prepare --lens``."""
    pelvis, zoom = body.rest(video.shape).joints[0], truth.cameras[0].fx / video.cameras[0].fx
    pose, cameras = zoomed(video.pose, pelvis, video.cameras, zoom)
    return replace(video, cameras=list(cameras), pose=pose)


@options_of("study")
class AvatarStudyOptions(VideoOptions):
    """Size of the avatar study."""

    frames: VideoFrames = 80  # frames of each video
    steps: Annotated[int, Within(1, 1_000_000)] = 3000  # steps of each fit
    novel: PythonOnly[NovelPictures] = 8  # pictures of novel poses, and as many of novel views
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
        """Video the takes, refine each case, then fit each variant."""
        cases = list(dict.fromkeys(case for case, _ in missing))
        made = self.body, self.options.refine, self.stamp
        prepared = [
            Work(partial(prepare_case, self.filming.subject(case), case, *made)) for case in cases
        ]
        fitted = [Work(self.run(*pair).solve) for pair in missing]
        return [self.filming.work(cases, self.body), prepared, fitted]

    def run(self, case: StudyCase, variant: str) -> VariantRun:
        """Return the run of a variant; the case's folder must exist before it is solved."""
        (row,) = (row for row in self.rows if row.name == variant)
        out = self.folder / "runs" / file_name(case.name) / file_name(variant)
        options = replace(self.options.fit, seed=case.draw, steps=self.options.steps)
        options = options.of_video() if case.noise == VIDEO_KIND else options
        return VariantRun(self.filming.subject(case), out, row, self.body, options, self.stamp)


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
    """Write refined poses into a case's folder, unless it has those of the same options."""
    if not is_fresh(subject / PREPARED, stamp):
        evaluation = refine_case(subject, case, body, options, progress=progress)
        write_refinement(evaluation)
        (subject / PRINTED_POSES).unlink(missing_ok=True)
        write_record(subject / PREPARED, {}, stamp)


@dataclass(frozen=True)
class VariantRun:
    """Fit one variant to one case, and measure it."""

    subject: Path  # the case's folder, refined
    out: Path  # the run's folder
    variant: AvatarVariant
    body: BodyModel
    options: FitOptions  # of the study; the variant changes them
    stamp: str  # of the study

    def solve(self, progress: Progress | None = None) -> tuple[Figure, ...]:
        """Fit, or resume a fit, and return its figures."""
        self._make_room()
        if self.variant.poses == "printed" and not self._poses.exists():
            found = refine(load_video(self.subject), self.body, REFINE)
            save_poses(self._poses, found.pose, found.shape, stage=2)
        video, options = self.video(), self.variant.of(self.options)
        offsets = video.offsets_of(len(self.body.v_template))
        about = {"offsets": offsets, "resume": True, "progress": progress}
        avatar = fit(video, self.body, options, self.out, **about)
        args = (self.out, avatar, video, self.variant.name, self.body, self._poses)
        # Fitted poses would bend a rigid body.
        fitted = {"fit_to_pictures": not self.variant.rigid}
        return measure_run(*args, driven=self.driven(video), **fitted).figures

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
