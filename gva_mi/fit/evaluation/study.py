"""The study of the avatar: every row (:mod:`gva_mi.fit.evaluation.rows`) for several people.

The people, bodies and families of noise are those by which the refinement is judged
(:mod:`gva_mi.pose.evaluation.cases`): who was tuned on, and who judges, is written down there once
for both, and nobody is in both. Two rounds of work, each in parallel where there is an executor:

1. each person is filmed, each noise is drawn over the recording, and its poses are refined;
2. each row of each case is fitted and measured.

All of it stays in the study's folder::

    out/
      takes/, videos/        the subjects, refined
      runs/CASE/ROW/         the runs, in the form of gva_mi.fit.run_folder
      avatar.json            what was found: gva_mi.fit.evaluation.study_file
      avatar.html            the same as a page: gva_mi.fit.evaluation.study_report
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress, within
from gva_mi.data.fingerprint import fingerprint
from gva_mi.data.synthetic.options import NovelPictures, VideoFrames
from gva_mi.data.truth import load_truth
from gva_mi.data.video import load_video
from gva_mi.files import program_digest, says, versions, write_json
from gva_mi.fit.evaluation.evaluate import SplitScores
from gva_mi.fit.evaluation.metrics import Metrics
from gva_mi.fit.evaluation.row_run import RowRun
from gva_mi.fit.evaluation.rows import Row
from gva_mi.fit.evaluation.surface_figures import SurfaceFigures
from gva_mi.fit.options import FitOptions
from gva_mi.pose.evaluation.cases import Case
from gva_mi.pose.evaluation.measure import Evaluation
from gva_mi.pose.evaluation.record import write_record
from gva_mi.pose.evaluation.subjects import Filming
from gva_mi.pose.parallel import run
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.ranges import PictureSide, require_ranges

PREPARED = "prepared.json"  # in a case's folder: what its refined poses were made with
ROUGHLY = 10  # steps of a fit that refining a frame takes as long as, for progress


@dataclass(frozen=True)
class AvatarStudyOptions:
    """How large the study is."""

    frames: VideoFrames = 80  # of each video
    size: PictureSide = 512  # pixels, width and height of the pictures
    novel: NovelPictures = 8  # pictures of novel poses, and as many of novel views
    refine: SequenceOptions = field(default_factory=SequenceOptions)
    fit: FitOptions = field(default_factory=FitOptions)

    def __post_init__(self) -> None:
        require_ranges("study", self)

    def filming(self, folder: Path) -> Filming:
        """How the videos are made, in a study's folder."""
        return Filming(folder, self.frames, self.size, self.novel)

    def made_with(self, body: BodyModel) -> dict[str, Any]:
        """All that a result depends on besides its case and its row, as JSON has it."""
        made = {"options": asdict(self), "body": fingerprint(body), "sources": program_digest()}
        return json.loads(json.dumps(made, default=str))


@dataclass(frozen=True)
class RowResult:
    """What came of one row for one case."""

    case: Case
    row: str
    scores: tuple[SplitScores, ...]
    surface: tuple[SurfaceFigures, ...]
    similarity: dict[str, float] | None
    networks: Mapping[str, Any]  # of the perceptual figures
    seconds: float  # of the fit
    gaussians: int
    poses_mm: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # as in metrics.json

    @staticmethod
    def of(case: Case, row: Row, metrics: Metrics) -> RowResult:
        """The figures of a run that the study keeps."""
        return RowResult(
            case,
            row.name,
            metrics.rows,
            metrics.surface,
            metrics.similarity,
            metrics.protocol.networks,
            metrics.training.seconds,
            metrics.training.gaussians,
            metrics.poses_mm,
        )


def study(
    folder: Path,
    cases: Sequence[Case],
    rows: Sequence[Row],
    body: BodyModel,
    options: AvatarStudyOptions,
    known: Sequence[RowResult] = (),
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[RowResult]:
    """Fit all rows for all cases, case by case.

    Args:
        folder: where everything is kept.
        cases: such as HELD_OUT.
        rows: of the table.
        body: the body that is fitted.
        options: how large.
        known: results that need not be computed again.
        progress: called as ``progress(done, total)`` as the work goes on.
        executor: who works; its workers need to see the folder. None: this process.
    """
    done = {(result.case, result.row): result for result in known}
    wanted = [(case, row) for case in cases for row in rows]
    missing = [(case, row) for case, row in wanted if (case, row.name) not in done]
    recordings = _recordings(folder, [case for case, _ in missing], body, options)
    fits = row_runs(folder, missing, body, options)
    first, second = (sum(work.steps for work in works) for works in (recordings, fits))
    for _ in run(recordings, executor, within(progress, 0, first, first + second)):
        pass
    found = run(fits, executor, within(progress, first, second, first + second))
    for case, row in wanted:
        there = done.get((case, row.name))
        yield there or RowResult.of(case, row, next(found).result)


def row_runs(
    folder: Path,
    wanted: Sequence[tuple[Case, Row]],
    body: BodyModel,
    options: AvatarStudyOptions,
) -> list[RowRun]:
    """The runs of some rows; their cases' folders must be there before one is solved."""
    made_with = options.made_with(body)
    return [
        RowRun(
            options.filming(folder).subject(case),
            folder / "runs" / _file_name(case.name) / _file_name(row.name),
            row,
            body,
            replace(options.fit, seed=case.draw),
            made_with,
        )
        for case, row in wanted
    ]


@dataclass(frozen=True)
class Recording:
    """One person's cases, filmed and refined: a :class:`gva_mi.pose.parallel.Work`."""

    folder: Path
    cases: tuple[Case, ...]  # of one take, so that no two workers film the same person
    body: BodyModel
    options: AvatarStudyOptions

    @property
    def steps(self) -> int:
        """How much work it is, in steps of a fit."""
        return ROUGHLY * self.options.frames * len(self.cases)

    def solve(self, progress: Progress | None = None) -> list[Path]:
        """Make what is missing, and refine what this program has not refined yet."""
        subjects = []
        for number, case in enumerate(self.cases):
            subject = self.options.filming(self.folder).film(case, self.body)
            marker, made_with = subject / PREPARED, self.options.made_with(self.body)
            if not says(marker, made_with):
                of_case = self.steps // len(self.cases)
                told = within(progress, number * of_case, of_case, self.steps)
                self._refine(subject, case, told)
                write_json(marker, made_with)
            subjects.append(subject)
        return subjects

    def _refine(self, subject: Path, case: Case, progress: Progress | None) -> None:
        video = load_video(subject, normals=None if case.normals else "none")
        options = replace(self.options.refine, seed=case.draw)
        refined = refine(video, self.body, options, progress)
        truth = load_truth(video.truth, self.body)
        write_record(Evaluation.of(video, self.body, options, refined, truth), versions())


def _recordings(
    folder: Path, cases: Sequence[Case], body: BodyModel, options: AvatarStudyOptions
) -> list[Recording]:
    """The work of the first round, a piece for each take."""
    takes = dict.fromkeys(case.take for case in cases)
    of_take = lambda take: tuple(dict.fromkeys(case for case in cases if case.take == take))
    return [Recording(folder, of_take(take), body, options) for take in takes]


def _file_name(name: str) -> str:
    return re.sub(r"\W+", "-", name).strip("-")
