"""The study in a table: a row for each family of noise, their mean, and the worst of them.

A family counts once, however many cases it has: its row is the mean over its cases, and the mean of
the table is that over families. The worst is looked for in each column by itself. Depths keep their
signs, for a mean of nothing but lengths would not tell noise from leaning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.study import CaseResult


@dataclass(frozen=True)
class Column:
    """One figure of the table."""

    name: str
    of: Callable[[PoseFigures], float | None]
    form: str  # how it is written
    badness: Callable[[float], float]  # the larger, the worse


def _same(x: float) -> float:
    return x


def _change(name: str, figure: str) -> Column:
    """By what share an error changed; above zero it grew."""

    def relative(figures: PoseFigures) -> float | None:
        change: Change | None = getattr(figures, figure)
        return None if change is None else change.relative

    return Column(name, relative, "{:+.0%}", _same)


def _depth(name: str, figure: str) -> Column:
    """Signed millimetres of the refined poses."""
    of = lambda figures: None if (c := getattr(figures, figure)) is None else c.refined
    return Column(name, of, "{:+.0f}", abs)


def _above_truth(figures: PoseFigures) -> float | None:
    known = figures.iou is not None and figures.iou_truth is not None
    return figures.iou.refined - figures.iou_truth if known else None


COLUMNS = (
    _change("body", "vertices"),
    _change("hands", "hands"),
    _change("feet", "feet"),
    _change("aligned body", "aligned"),
    _change("aligned hands", "hands_aligned"),
    _change("aligned feet", "feet_aligned"),
    _change("fingers", "fingers"),
    _depth("ankles, mm", "ankles_depth"),
    _depth("wrists, mm", "wrists_depth"),
    Column("worse", lambda figures: figures.frames_worse, "{:.0%}", _same),
    Column("worse hands", lambda figures: figures.frames_worse_hands, "{:.0%}", _same),
    Column("IoU - truth's", _above_truth, "{:+.3f}", lambda x: -x),
    Column("s a frame", lambda figures: figures.seconds_per_frame, "{:.2f}", _same),
)


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    name: str
    cases: int
    values: tuple[float, ...]  # one for each of COLUMNS; NaN where it is not known

    def cells(self) -> tuple[str, ...]:
        """Name, number of cases and values as they are printed."""
        written = (
            "" if math.isnan(x) else column.form.format(x).replace("%", " %")
            for column, x in zip(COLUMNS, self.values, strict=True)
        )
        return (self.name, str(self.cases), *written)

    def to_json(self) -> dict[str, float | int | None]:
        """Values by the names of their columns."""
        named = zip((column.name for column in COLUMNS), self.values, strict=True)
        return {"cases": self.cases} | {k: None if math.isnan(x) else x for k, x in named}


def rows_of(results: Sequence[CaseResult]) -> list[Row]:
    """A row for each family, then the mean over families, and the worst of each column."""
    families = list(_families(results))
    table = np.array([row.values for row in families])
    worst = (
        max((x for x in values if not math.isnan(x)), key=column.badness, default=math.nan)
        for column, values in zip(COLUMNS, table.T.tolist(), strict=True)
    )
    count = len(results)
    return [*families, Row("mean", count, _mean(table)), Row("worst", count, tuple(worst))]


def _families(results: Sequence[CaseResult]) -> Iterator[Row]:
    """In the order in which they come first."""
    noises = {result.noise for result in results}
    groups: dict[str, list[PoseFigures]] = {}
    for result in results:
        level = f", noise {result.noise:g}" if len(noises) > 1 else ""
        groups.setdefault(result.case.family + level, []).append(result.figures)
    for name, several in groups.items():
        table = np.array([[column.of(f) for column in COLUMNS] for f in several], dtype=float)
        yield Row(name, len(several), _mean(table))


def _mean(table: np.ndarray) -> tuple[float, ...]:
    """Mean of each column over what is known; NaN where nothing is."""
    known = ~np.isnan(table)
    sums, counts = np.where(known, table, 0).sum(0), known.sum(0)
    return tuple(np.where(counts, sums / np.maximum(counts, 1), np.nan).tolist())
