"""The long table: every measured figure is one row of it, and every page is a pivot of it.

::

    subject | variant | split | region | alignment | metric | value | spread | runs

``metrics.json`` of a run, ``refinement.json`` of a subject, the file of a study and the output of
``gva-mi score`` hold such rows, so that one line makes a CSV file of them::

    csv.DictWriter(file, rows[0]).writerows(rows)

A name that does not apply is empty. :data:`METRICS` lists all metrics. The value may be a mean of
several runs that differ by one float32 ulp in one input (``gva-mi study --repeats``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gva_mi.core.options import from_json


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One row of the long table."""

    subject: str = ""  # the person of the video; of a study, the case
    variant: str = ""  # how it was made
    split: str = ""  # frames of the video
    region: str = ""  # part of the picture or of the body
    alignment: str = ""  # what was aligned before measuring, or which poses or light
    metric: str
    value: float | None  # None: not known
    spread: float | None = None  # standard deviation over runs; None: of one run
    runs: int = 1


def mean_of_runs(runs: Sequence[Sequence[Figure]]) -> list[Figure]:
    """Average the figures of several runs of the same work, and keep their spread.

    Example:
        >>> runs = [[Figure(metric="PSNR, dB", value=value)] for value in (30.0, 30.2)]
        >>> [mean] = mean_of_runs(runs)
        >>> round(mean.value, 2), round(mean.spread, 2), mean.runs
        (30.1, 0.14, 2)
    """
    if len(runs) == 1:
        return list(runs[0])
    found: dict[Figure, list[float | None]] = {}
    for figure in (figure for run in runs for figure in run):
        found.setdefault(replace(figure, value=None), []).append(figure.value)
    means = []
    for about, values in found.items():
        known = [value for value in values if value is not None]
        if len(known) < 2:
            means.append(replace(about, value=known[0] if known else None))
        else:
            mean, spread = float(np.mean(known)), float(np.std(known, ddof=1))
            means.append(replace(about, value=mean, spread=spread, runs=len(known)))
    return means


def farthest(values: Iterable[float]) -> float:
    """Return the value that is farthest from 0."""
    return max(values, key=abs)


@dataclass(frozen=True)
class Metric:
    """How the values of a metric are written, and which of several is the worst."""

    form: str
    worst: Callable[[Iterable[float]], float] = max


STAGES = ("stage 1", "refined", "given", "trained")  # of poses; "given": to the fit
METRICS = {
    "PSNR, dB": Metric(".2f", min),
    "SSIM": Metric(".4f", min),
    "LPIPS": Metric(".4f"),
    "rand_vgg": Metric(".4f"),
    "pictures": Metric(".0f"),  # or boxes, in the mean of a score
    "error, mm": Metric(".1f"),  # of poses; a row of the table names their stage
    **{f"{stage} error, mm": Metric(".1f") for stage in STAGES},
    **{f"{stage} depth, mm": Metric("+.1f", farthest) for stage in STAGES},
    "change": Metric("+.0%"),  # of an error by the refinement, relative
    "increased": Metric(".0%"),  # share of frames whose error increased
    **{f"{stage} IoU": Metric(".3f", min) for stage in (*STAGES, "true", "mask")},
    "in 90 % region": Metric(".0%", min),  # share of joints within their predicted 90 % region
    **{f"{name}rms, mm": Metric(".1f") for name in ("", "predicted ")},  # of joints
    "IoU - limit": Metric("+.3f", min),  # of refined poses, less the IoU of true poses
    "s a frame": Metric(".2f"),
    "steps": Metric(",.0f"),
    "seconds": Metric(",.0f"),
    "Gaussians": Metric(",.0f"),
    "foreign": Metric(".1%"),  # share of pixels in the colours of another part
    "opaque Gaussians": Metric(",.0f"),
    "spacing": Metric(".2f"),
    "bias, mm": Metric(".1f"),
    "area, m²": Metric(".2f"),  # of the surface that a re-initialisation found
    "open edges": Metric(",.0f"),  # of the same: 0 if it is closed
    "stray, mm": Metric(".1f"),
    # of videos by several cameras: gva-mi study multiview
    **{f"{name}, px": Metric(".0f") for name in ("lens", "true lens", "points")},
    "up, degrees": Metric(".1f"),
    **{f"{name}, mm": Metric(".0f") for name in ("joints", "depth", "aligned", "aside", "network")},
}


def text_of(value: float | None, metric: str) -> str:
    """Write the value of a metric; a dash for None."""
    return "–" if value is None else f"{value:{METRICS[metric].form}}".replace("%", " %")


def where(figures: Iterable[Figure], **names: str | tuple[str, ...]) -> list[Figure]:
    """Return the rows whose columns have some values, such as ``region=("hands", "face")``."""
    wanted = {name: (x,) if isinstance(x, str) else x for name, x in names.items()}
    return [f for f in figures if all(getattr(f, name) in x for name, x in wanted.items())]


Key = tuple[str, ...]
Cells = dict[Key, dict[Key, np.ndarray]]  # by row and column; a column's last name is its metric


def pivot(figures: Iterable[Figure], index: Sequence[str], columns: Sequence[str] = ()) -> Cells:
    """Arrange figures in rows and columns.

    Args:
        figures: those whose value is unknown or not finite are left out.
        index: names of :class:`Figure` whose values distinguish the rows.
        columns: names whose values distinguish the columns, beside the metric.

    Returns:
        A value (n,) of each subject in each cell: a subject counts once, so that several figures of
        it are averaged. Rows and columns come in the order in which they appear.
    """
    grouped: dict[Key, dict[Key, dict[str, list[float]]]] = {}
    key = lambda figure, names: tuple(getattr(figure, name) for name in names)
    for figure in figures:
        if figure.value is not None and math.isfinite(figure.value):
            cells = grouped.setdefault(key(figure, index), {})
            cell = cells.setdefault(key(figure, (*columns, "metric")), {})
            cell.setdefault(figure.subject, []).append(figure.value)
    means = lambda cell: np.array([np.mean(values) for values in cell.values()])
    return {row: {c: means(cell) for c, cell in cells.items()} for row, cells in grouped.items()}


@dataclass(frozen=True)
class Table:
    """Rows of text under a head."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: bool = False  # cells are sentences, which wrap, and not numbers


def mean_text(row: Key, column: Key, values: np.ndarray) -> str:
    """Write the mean of a cell."""
    return text_of(float(values.mean()), column[-1])


def table(
    cells: Cells, title: str = "", write: Callable[[Key, Key, np.ndarray], str] = mean_text
) -> Table:
    """Write cells as text, under a head that begins with ``title``."""
    columns = list(dict.fromkeys(column for row in cells.values() for column in row))
    single = len({column[-1] for column in columns}) == 1 < len(columns)
    head = [label_of(column[:-1] if single else column) for column in columns]
    rows = [
        [label_of(row), *(write(row, c, of_row[c]) if c in of_row else "–" for c in columns)]
        for row, of_row in cells.items()
    ]
    return Table((title, *head), rows)


def label_of(key: Key) -> str:
    """Join the names of a row or column that are not empty."""
    return ", ".join(name.replace("_", " ") for name in key if name)


def to_json(figures: Iterable[Figure]) -> list[dict[str, Any]]:
    """Return the rows as files hold them."""
    return [asdict(figure) for figure in figures]


def figures_from(rows: Iterable[Mapping[str, Any]]) -> tuple[Figure, ...]:
    """Invert :func:`to_json`.

    Raises:
        ValueError: something is not a row, or a metric is unknown.
    """
    found = tuple(from_json(Figure, row) for row in rows)
    for figure in found:
        if figure.metric not in METRICS:
            raise ValueError(f"the metric '{figure.metric}' is unknown")
    return found
