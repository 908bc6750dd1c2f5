"""A study: cases x variants -> figures, kept in one file that is resumed.

:mod:`gva_mi.study.refine_study` and :mod:`gva_mi.study.avatar_study` say what a case and a variant
are, and how one is computed. Here is what both share. A study's folder holds::

    takes/, videos/     the subjects, made where they are missing
    KIND.json           {"kind", "made_with", "versions", "stamp", "cases": {name: case},
                         "figures": rows of gva_mi.evaluate.figures, whose subject is a case's name}
    KIND.html           the same as a page
    runs/CASE/VARIANT/  runs of the avatar study, in the form of gva_mi.fit.run_folder

A result is used again only if everything it depends on is the same: the options, the body, and the
results version of the study (:mod:`gva_mi.core.stamp`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import from_json
from gva_mi.core.stamp import RESULTS_VERSIONS, is_fresh, stamp, write_record
from gva_mi.core.tasks import Task, run
from gva_mi.evaluate.figures import Figure, figures_from, to_json
from gva_mi.study.cases import StudyCase
from gva_mi.study.videos import StudyVideos, VideoOptions
from gva_mi.subject.fingerprint import VIDEO_KIND, fingerprint

EXPECTED = "what `gva-mi study` writes, or give --overwrite"


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
    def videos(self) -> StudyVideos:
        """Its videos."""
        return StudyVideos(self.folder, self.options)

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
            if record.get("video_version") != RESULTS_VERSIONS["video"]:
                cases = {name: x for name, x in cases.items() if x.noise != VIDEO_KIND}
            found: dict[tuple[str, str], list[Figure]] = {}
            for figure in figures_from(record["figures"]):
                found.setdefault((figure.subject, figure.variant), []).append(figure)
            return [
                Outcome(cases[name], variant, tuple(figures))
                for (name, variant), figures in found.items()
                if name in cases
            ]

    def save(self, outcomes: Sequence[Outcome]) -> None:
        """Write all results."""
        record = {"kind": self.kind, "made_with": self.made_with}
        record["video_version"] = RESULTS_VERSIONS["video"]  # which simulated subjects do not need
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
            labelled = (replace(figure, subject=case.name, variant=variant) for figure in figures)
            yield Outcome(case, variant, tuple(labelled))
