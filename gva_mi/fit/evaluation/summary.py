"""The study in tables: a line for each row, mean and spread over people.

A person counts once, however many noises are drawn over their video: the figures of their cases are
averaged first. The spread is the standard deviation over people. People who were tuned on and
people who judge are never averaged together.

"Against full" are differences to the row "full" of the same case, averaged likewise: people differ
more among each other than rows do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gva_mi.fit.evaluation.evaluate import Region, Split, SplitScores
from gva_mi.fit.evaluation.metrics import ALIGNED, AS_REFINED
from gva_mi.fit.evaluation.rows import FULL
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.fit.photometric import FITTED
from gva_mi.pose.evaluation.cases import HELD_OUT, Case


@dataclass(frozen=True)
class Column:
    """One figure of a row of the study."""

    name: str
    of: Callable[[RowResult], float | None]
    digits: int = 2
    better: int = 1  # 1: more is better; -1: less; 0: neither


@dataclass(frozen=True)
class Figure:
    """A column over people."""

    mean: float
    spread: float  # standard deviation over people; 0 for one
    worst: float
    people: int


def score(
    metric: str, split: Split, region: Region = "white", poses: str | None = None
) -> Callable[[RowResult], float | None]:
    """A figure of the renders of a row.

    Args:
        metric: a field of SplitScores.
        split: of the frames.
        region: of the pictures.
        poses: the poses that they are rendered under; None: the row's own.
    """

    def of(result: RowResult) -> float | None:
        wanted = ((poses or result.row), split, region)
        rows = (row for row in result.scores if (row.name, row.split, row.region) == wanted)
        found: SplitScores | None = next(rows, None)
        return None if found is None else getattr(found, metric)

    return of


def _splits(metric: str, digits: int, better: int) -> tuple[Column, ...]:
    """A metric on all splits, over the whole picture."""
    return (
        Column(f"{metric}: test", score(metric, "test"), digits, better),
        Column(
            f"{metric}: test, poses as given",
            score(metric, "test", poses=AS_REFINED),
            digits,
            better,
        ),
        Column(
            f"{metric}: test, poses fitted", score(metric, "test", poses=FITTED), digits, better
        ),
        *(
            Column(
                f"{metric}: {split.replace('_', ' ')}{', aligned' if poses else ''}",
                score(metric, split, poses=poses),
                digits,
                better,
            )
            for split in ("novel_pose", "novel_view")
            for poses in (None, ALIGNED)
        ),
    )


def _regions(split: Split, poses: str | None) -> tuple[Column, ...]:
    """PSNR in all regions of a split."""
    where = f"{split.replace('_', ' ')}{', aligned' if poses else ''}"
    return tuple(
        Column(f"psnr: {where}, {region}", score("psnr", split, region, poses))
        for region in ("black", "person", "hands")
    )


def _surface(name: str, figure: str, key: str, moment: str) -> Column:
    """A figure of the surface at the last such moment of a fit."""

    def of(result: RowResult) -> float | None:
        there = [figures for figures in result.surface if figures.moment == moment]
        return getattr(there[-1], figure).get(key) if there else None

    return Column(name, of, 2 if figure == "spacing" else 1, -1)


PSNR = _splits("psnr", 2, 1)
SSIM = _splits("ssim", 4, 1)
LPIPS, RAND_VGG = _splits("lpips", 4, -1), _splits("rand_vgg", 4, -1)
REGION_COLUMNS = (
    *_regions("test", None), *_regions("novel_pose", ALIGNED), *_regions("novel_view", ALIGNED),
)  # fmt: skip
SURFACE = (
    _surface("spacing before a re-initialisation", "spacing", "all", "before"),
    _surface("spacing after it", "spacing", "all", "after"),
    _surface("spacing at the end", "spacing", "all", "end"),
    _surface("patterned cloth at the end", "spacing", "patterned cloth", "end"),
    _surface("bias of hair before, mm", "bias_mm", "hair", "before"),
    _surface("after, mm", "bias_mm", "hair", "after"),
    _surface("bias of hair at the end, mm", "bias_mm", "hair", "end"),
    _surface("bias of hem at the end, mm", "bias_mm", "hem", "end"),
    _surface("bias of the rest, mm", "bias_mm", "rest", "end"),
)
COST = (
    Column("seconds", lambda result: result.seconds, 0, -1),
    Column("Gaussians", lambda result: float(result.gaussians), 0, 0),
)
COLUMNS = (*PSNR, *SSIM, *LPIPS, *RAND_VGG, *REGION_COLUMNS, *SURFACE, *COST)


def is_held_out(case: Case) -> bool:
    """Whether nothing was tuned on a case."""
    return case in HELD_OUT


def by_people(results: Sequence[RowResult]) -> dict[str, list[RowResult]]:
    """The results of people who judge, and of those who were tuned on; no group is empty."""
    groups = {
        "held-out people": [r for r in results if is_held_out(r.case)],
        "people it was tuned on": [r for r in results if not is_held_out(r.case)],
    }
    return {name: group for name, group in groups.items() if group}


def summaries(results: Sequence[RowResult]) -> dict[str, dict[str, dict[str, Figure]]]:
    """The figures of each group of people, by row and the name of the column."""
    return {
        name: {
            row: {column.name: f for column in COLUMNS if (f := figure(group, row, column))}
            for row in dict.fromkeys(result.row for result in group)
        }
        for name, group in by_people(results).items()
    }


def figure(results: Sequence[RowResult], row: str, column: Column) -> Figure | None:
    """One cell of a table; None where nobody has the figure."""
    values = [(r.case, column.of(r)) for r in results if r.row == row]
    return _over_people(values, column.better)


def against_full(results: Sequence[RowResult], row: str, column: Column) -> Figure | None:
    """The difference of a cell to that of the row "full", case by case."""
    full = {r.case: column.of(r) for r in results if r.row == FULL.name}
    values = []
    for result in results:
        value, whole = column.of(result), full.get(result.case)
        if result.row == row and value is not None and whole is not None:
            values.append((result.case, value - whole))
    return _over_people(values, column.better)


def _over_people(values: Sequence[tuple[Case, float | None]], better: int) -> Figure | None:
    people: dict[str, list[float]] = {}
    for case, value in values:
        if value is not None and math.isfinite(value):
            people.setdefault(case.take.name, []).append(value)
    if not people:
        return None
    means = np.array([np.mean(own) for own in people.values()])
    worst = means.max() if better < 0 else means.min()
    return Figure(float(means.mean()), float(means.std()), float(worst), len(means))
