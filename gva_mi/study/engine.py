"""The engine of both studies: cases x variants -> figures, kept in one file that is resumed.

A study's folder holds::

    takes/, videos/     the subjects, made where they are missing
    KIND.json           {"format": 2, "kind", "made_with", "networks", "summary", "versions",
                         "results": [{"name", "held_out", "case", "variant", "figures"}]}
    KIND.html           the same as a page
    runs/CASE/VARIANT/  runs of the avatar study

A result is used again only if everything it depends on is the same: the options, the body, and the
results version of the study (:data:`gva_mi.core.provenance.RESULTS_VERSIONS`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress, within
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.core.options import from_json
from gva_mi.core.provenance import RESULTS_VERSIONS, versions
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


class Study(Protocol):
    """The work for each case, and the inputs that the figures depend on."""

    kind: str  # names its files
    variants: Sequence[str]
    made_with: dict[str, Any]

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Return work in rounds; each piece of the last one returns the figures of a pair."""
        ...


def made_with(kind: str, options: Any, body: BodyModel) -> dict[str, Any]:  # noqa: ANN401
    """Return all that a result depends on besides its case and variant, as JSON has it.

    Args:
        kind: of the study.
        options: a dataclass.
        body: that is fitted.
    """
    made = {
        "options": asdict(options),
        "body": fingerprint(body),
        "results_version": RESULTS_VERSIONS[kind],
    }
    return json.loads(json.dumps(made, default=str))


def run_study(
    study: Study,
    cases: Sequence[StudyCase],
    known: Sequence[Outcome] = (),
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[Outcome]:
    """Yield the outcome of every case and variant, case by case, computing what is not known.

    Args:
        study: gives the work.
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
        for _ in run(works, executor, within(progress, before, steps, total)):
            pass
        before += steps
    found = run(last, executor, within(progress, before, total - before, total))
    for pair in wanted:
        yield done[pair] if pair in done else Outcome(*pair, next(found).result)


@dataclass(frozen=True)
class StudyFile:
    """The file of a study's results."""

    path: Path
    kind: str
    made_with: dict[str, Any]

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
            same = (record["kind"], record["made_with"]) == (self.kind, self.made_with)
            return [_outcome(row) for row in record["results"]] if same else []

    def save(self, outcomes: Sequence[Outcome], summary: dict[str, Any]) -> None:
        """Write all results, and the summary of those that were asked for."""
        results = [
            {
                "name": outcome.case.name,
                "held_out": outcome.case.held_out,
                "case": asdict(outcome.case),
                "variant": outcome.variant,
                "figures": outcome.figures,
            }
            for outcome in outcomes
        ]
        record = {"format": FORMAT, "kind": self.kind, "made_with": self.made_with}
        record |= {"summary": summary, "results": results, "versions": versions()}
        write_json(self.path, record)


def _outcome(row: dict[str, Any]) -> Outcome:
    return from_json(Outcome, {name: row[name] for name in ("case", "variant", "figures")})
