"""Cells of a table in Markdown, from rows of figures: docs/tables.py says which.

A :class:`Part` is a row or a column of a :class:`Table`, and names the figures in it by the values
of their columns. :class:`Shown` says how those of a cell are averaged and written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import mean, stdev

from gva_mi.evaluate.figures import STAGES

Row = dict[str, str]  # of figures.csv, by column
Where = Mapping[str, str | tuple[str, ...]]  # columns, and their values or one of these


def extremes(values: Sequence[float]) -> tuple[float, float]:
    """Return the least and the largest value."""
    return min(values), max(values)


@dataclass(frozen=True)
class Shown:
    """How the figures of a cell are written: as numbers of one metric, joined."""

    metric: str  # for poses without their stage: "error, mm"
    where: Where = field(default_factory=dict)
    each: tuple[str, tuple[str, ...]] | None = None  # a column, and its value in each number
    form: str = ".0f"
    unit: str = ""
    join: str = ", "
    scale: float = 1
    of: Callable[[Sequence[float]], float | tuple[float, float]] = mean  # over subjects
    minus: Where | None = None  # subtract the figure of the same subject that differs in this
    error: bool = False  # add the standard error of the mean over subjects


@dataclass(frozen=True)
class Part:
    """A row or a column of a table: its figures and, in either of both, how they are written."""

    label: str
    shown: Shown | None
    where: Where
    note: str = ""  # of a row: text in the last column
    minus: Where | None = None  # of a row: as of Shown, in all its cells


@dataclass(frozen=True)
class Table:
    """A table of a page."""

    corner: str  # above the rows' names
    rows: Sequence[Part]
    columns: Sequence[Part]
    notes: str = ""  # above the rows' notes, if they have any


def part(label: str, shown: Shown | None = None, note: str = "", **where: str) -> Part:
    """Return a row or a column of the figures whose columns have some values."""
    return Part(label, shown, where, note)


def staged(figure: Row) -> Row:
    """Split a metric such as "trained error, mm" into stage and metric."""
    stage = next((x for x in STAGES if figure["metric"].startswith(f"{x} ")), "")
    metric = figure["metric"][len(stage) :].strip()
    return figure | {
        "stage": stage or "refined" * (metric in ("change", "increased")),
        "metric": metric,
    }


class Writer:
    """Write tables from figures, and remember which figures they show."""

    def __init__(self, figures: Sequence[Row]) -> None:
        """Keep the rows of ``figures.csv``."""
        self.figures = [staged(figure) for figure in figures]
        self.used: set[int] = set()

    def values(self, where: Where) -> dict[str, float]:
        """Return the means of some figures by subject; a cell with ``counts``, by that column."""
        counts = str(where.get("counts", "subject"))
        found: dict[str, list[float]] = {}
        for k, figure in enumerate(self.figures):
            if all(
                figure[name] in ((x,) if isinstance(x, str) else x)
                for name, x in where.items() if name != "counts"
            ):  # fmt: skip
                self.used.add(k)
                found.setdefault(figure[counts], []).append(float(figure["value"]))
        return {name: mean(values) for name, values in found.items()}

    def cell(self, row: Part, column: Part) -> str:
        """Write a cell; a dash for a figure that is missing."""
        shown = row.shown or column.shown
        at = {**column.where, **row.where, **shown.where, "metric": shown.metric}
        name, each = shown.each or ("metric", (shown.metric,))
        numbers: list[str] = []
        for x in each:
            values = self.values(at | {name: x})
            if (minus := row.minus or shown.minus) is not None:
                others = self.values(at | {name: x} | minus)
                values = {key: values[key] - others[key] for key in values.keys() & others.keys()}
            found = shown.of(list(values.values())) if values else None
            found = found if isinstance(found, tuple) else (found,)
            numbers += [number(x, shown) for x in found]
            if shown.error and len(values) > 1:
                deviation = stdev(values.values()) / len(values) ** 0.5
                numbers[-1] += f" ± {shown.scale * deviation:{shown.form.lstrip('+')}}"
        text = shown.join.join(numbers)
        return "–" if set(numbers) == {"–"} else text + shown.unit

    def table(self, table: Table) -> str:
        """Write a table in Markdown."""
        notes = [table.notes] if table.notes else []
        head = [table.corner, *(column.label for column in table.columns), *notes]
        lines = [head]
        for row in table.rows:
            cells = [self.cell(row, column) for column in table.columns]
            lines.append([row.label, *cells, *([row.note] if notes else [])])
        first, *others = (f"| {' | '.join(line)} |\n".replace("|  |", "| |") for line in lines)
        return "".join((first, "|---" * len(head) + "|\n", *others))


def number(value: float | None, shown: Shown) -> str:
    """Write a number, without the sign of a rounded zero."""
    if value is None:
        return "–"
    text = f"{shown.scale * value:{shown.form}}"
    return text.lstrip("+-") if not text.strip("+-0.") else text.replace("-", "−")
