"""The study's file: what was found, row by row, so that a study which was cut short goes on.

::

    {"results": [{"name", "case", "held_out", "row", "scores", "surface", "similarity", "seconds",
                  "gaussians", "poses_mm"}],
     "networks": of the perceptual figures, "paper": its tables,
     "summary": {people: {row: {column: {"mean", "spread", "worst", "people", "against_full"}}}},
     "made_with": {...}, "versions": {...}}

A result is used again only where all that it depends on is the same: the options, the body, and
every line of this program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from gva_mi.files import versions, write_json
from gva_mi.fit.evaluation.paper import TABLES
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.fit.evaluation.summary import is_held_out, summaries
from gva_mi.pose.evaluation.study_file import still_holding
from gva_mi.records import from_json


def save_results(
    path: Path,
    results: Sequence[RowResult],
    made_with: dict[str, Any],
    others: Sequence[RowResult] = (),
) -> None:
    """Write the file.

    Args:
        path: of it.
        results: of the cases and rows that were asked for; the summary is theirs.
        made_with: :meth:`gva_mi.fit.evaluation.study.AvatarStudyOptions.made_with`.
        others: results of other cases and rows, which are kept.
    """
    record = {
        "results": [_record(result) for result in (*results, *others)],
        "summary": {
            people: {
                row: {column: asdict(figure) for column, figure in columns.items()}
                for row, columns in rows.items()
            }
            for people, rows in summaries(results).items()
        },
        "networks": results[0].networks if results else {},
        "paper": [asdict(table) for table in TABLES],
        "made_with": made_with,
        "versions": versions(),
    }
    write_json(path, record)


def load_results(path: Path, made_with: dict[str, Any]) -> list[RowResult]:
    """The results of a file that still hold; none where there is no file.

    Raises:
        InputError: the file cannot be read.
    """
    return still_holding(
        path,
        made_with,
        lambda record: [_result(row, record["networks"]) for row in record["results"]],
    )


def _record(result: RowResult) -> dict[str, Any]:
    """One result; the names of networks are those of the whole file."""
    kept = {f.name: getattr(result, f.name) for f in fields(result) if f.name != "networks"}
    kept |= {
        "case": asdict(result.case),
        "scores": [asdict(row) for row in result.scores],
        "surface": [asdict(figures) for figures in result.surface],
    }
    return {"name": result.case.name, "held_out": is_held_out(result.case), **kept}


def _result(record: dict[str, Any], networks: dict[str, Any]) -> RowResult:
    kept = {f.name: record[f.name] for f in fields(RowResult) if f.name != "networks"}
    return from_json(RowResult, kept | {"networks": networks})
