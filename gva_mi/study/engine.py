"""The engine of both studies: cases x variants -> figures, kept in one file that is resumed.

A study's folder holds::

    takes/, videos/     the subjects, made where they are missing
    KIND.json           {"format": 2, "kind", "made_with", "networks", "summary", "versions",
                         "stamp", "results": [{"name", "held_out", "case", "variant", "figures"}]}
    KIND.html           the same as a page
    runs/CASE/VARIANT/  runs of the avatar study

A result is used again only if everything it depends on is the same: the options, the body, and the
results version of the study (:mod:`gva_mi.core.stamp`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import from_json
from gva_mi.core.stamp import RESULTS_VERSIONS, is_fresh, stamp, write_record
from gva_mi.core.tasks import Task, run
from gva_mi.data.fingerprint import fingerprint
from gva_mi.study.cases import StudyCase

FORMAT = 2
EXPECTED = "what `gva-mi study` writes, or give --overwrite"


@dataclass(frozen=True)
class Outcome:
    """Figures of one variant for one case."""

    case: StudyCase
    variant: str
    figures: Mapping[str, float | str | None]  # by name

    @property
    def key(self) -> tuple[StudyCase, str]:
        """Identity of the outcome in its study."""
        return self.case, self.variant


class Work(NamedTuple):
    """A piece of a study's work: a Task."""

    steps: int  # its amount, for the progress bar
    call: Callable[..., Any]  # a partial function that can be pickled; takes ``progress``

    def solve(self, progress: Progress | None = None) -> Any:  # noqa: ANN401
        """Do the work in this process."""
        return self.call(progress=progress)


@dataclass(frozen=True)
class Study(ABC):
    """The inputs of a study, and the file of its results."""

    folder: Path
    body: BodyModel  # that is fitted
    options: Any  # a dataclass
    kind: ClassVar[str]  # names its files

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
            InputError: the file cannot be read, or an older version wrote it.
        """
        if not self.path.exists():
            return []
        record = read_json(self.path, EXPECTED)
        with expecting(self.path, EXPECTED):
            if record.get("format") != FORMAT:
                raise InputError(
                    f"{self.path}: another version of gva-mi wrote this study; choose another "
                    "--out, or give --overwrite to compute it again"
                )
            fresh = is_fresh(self.path, self.stamp)
            return [_outcome(row) for row in record["results"]] if fresh else []

    def save(self, outcomes: Sequence[Outcome], summary: dict[str, Any]) -> None:
        """Write all results, and the summary of those that were asked for."""
        results = [
            {"name": outcome.case.name, "held_out": outcome.case.held_out, **asdict(outcome)}
            for outcome in outcomes
        ]
        record = {"format": FORMAT, "kind": self.kind, "made_with": self.made_with}
        record |= {"summary": summary, "results": results}
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
    for pair in wanted:
        yield done[pair] if pair in done else Outcome(*pair, next(found).result)


def _outcome(row: dict[str, Any]) -> Outcome:
    return from_json(Outcome, {name: row[name] for name in ("case", "variant", "figures")})
