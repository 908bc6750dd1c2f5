"""The study's file: what was found, case by case, so that a study which was cut short goes on.

::

    {"cases": [{"name", "case", "noise", "figures"}], "families": {name: figures},
     "made_with": {"options", "body", "sources"}, "versions": {...}}

A result is used again only where all that it depends on is the same: the options, the body, and
every line of this program (``sources`` is their digest).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from gva_mi.body.smplx import BodyModel
from gva_mi.data.fingerprint import fingerprint
from gva_mi.errors import expecting
from gva_mi.files import program_digest, read_json, versions, write_json
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.study import CaseResult, StudyOptions
from gva_mi.pose.evaluation.summary import rows_of
from gva_mi.records import from_json

Result = TypeVar("Result")


def save_study(
    path: Path,
    results: Sequence[CaseResult],
    body: BodyModel,
    options: StudyOptions,
    others: Sequence[CaseResult] = (),
) -> None:
    """Write the file.

    Args:
        path: of it.
        results: of the cases that were asked for; the table is theirs.
        body: the body that was fitted.
        options: how large the study is.
        others: results of other cases, which are kept.
    """
    found = [
        {
            "name": result.case.name,
            "case": asdict(result.case),
            "noise": result.noise,
            "figures": result.figures.to_json(),
        }
        for result in (*results, *others)
    ]
    record = {
        "cases": found,
        "families": {row.name: row.to_json() for row in rows_of(results)},
        "made_with": _made_with(body, options),
        "versions": versions(),
    }
    write_json(path, record)


def load_study(path: Path, body: BodyModel, options: StudyOptions) -> list[CaseResult]:
    """The results of a file that still hold; none where there is no file.

    Raises:
        InputError: the file cannot be read.
    """
    return still_holding(
        path,
        _made_with(body, options),
        lambda record: [_result(row) for row in record["cases"]],
    )


def still_holding(
    path: Path, made_with: dict[str, Any], read: Callable[[dict[str, Any]], list[Result]]
) -> list[Result]:
    """The results of a study's file, if they were made with the same; else none.

    Raises:
        InputError: the file cannot be read.
    """
    if not path.exists():
        return []
    expected = "what `gva-mi study` writes, or give --overwrite"
    record = read_json(path, expected)
    with expecting(path, expected):
        return read(record) if record["made_with"] == made_with else []


def _result(row: dict[str, Any]) -> CaseResult:
    kept = {"case": row["case"], "noise": row["noise"]}
    return from_json(CaseResult, kept | {"figures": PoseFigures.from_json(row["figures"])})


def _made_with(body: BodyModel, options: StudyOptions) -> dict[str, Any]:
    """All that a result depends on besides its case and the level of its noise."""
    chosen = asdict(options)
    del chosen["noise"]
    made = {"options": chosen, "body": fingerprint(body), "sources": program_digest()}
    return json.loads(json.dumps(made, default=str))
