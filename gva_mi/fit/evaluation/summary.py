"""The study in tables: a line for each row, mean and spread over people.

A person counts once, however many noises are drawn over their video: the figures of their cases are
averaged first. The spread is the standard deviation over people. People who were tuned on and
people who judge are never averaged together.

"Against full" are differences to the row "full" of the same case, averaged likewise: people differ
more among each other than rows do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gva_mi.fit.evaluation.evaluate import Region, Split, SplitScores
from gva_mi.fit.evaluation.metrics import ALIGNED, AS_REFINED, GIVEN, TRAINED
from gva_mi.fit.evaluation.rows import FULL
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.fit.photometric import FITTED
from gva_mi.pose.evaluation.cases import TUNING, Case


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
    against_full: float | None  # mean difference to the row "full" of the same cases


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


# A name, the split, and the poses that it is rendered under.
_TEST = ("test", "test", None)
_STRICT_POSE = ("novel pose", "novel_pose", None)
_STRICT_VIEW = ("novel view", "novel_view", None)
_NOVEL_POSE = ("novel pose, aligned", "novel_pose", ALIGNED)
_NOVEL_VIEW = ("novel view, aligned", "novel_view", ALIGNED)
_WHOLE = (
    _TEST,
    ("test, poses as given", "test", AS_REFINED),
    ("test, poses fitted", "test", FITTED),
    _STRICT_POSE,
    _NOVEL_POSE,
    ("novel pose, poses fitted", "novel_pose", FITTED),
    _STRICT_VIEW,
    _NOVEL_VIEW,
    ("novel view, poses fitted", "novel_view", FITTED),
)


def _whole(metric: str, digits: int, better: int) -> tuple[Column, ...]:
    """A metric over the whole picture, wherever it is measured."""
    return tuple(
        Column(f"{metric}: {name}", score(metric, split, poses=poses), digits, better)
        for name, split, poses in _WHOLE
    )


def _part(region: Region) -> tuple[Column, ...]:
    """PSNR in a region."""
    return tuple(
        Column(f"psnr: {name}, {region}", score("psnr", split, region, poses))
        for name, split, poses in (_TEST, _STRICT_POSE, _STRICT_VIEW, _NOVEL_POSE, _NOVEL_VIEW)
    )


def _millimetres(name: str, error: str) -> tuple[Column, ...]:
    """An error of the poses, as they were given and as they were trained."""

    def of(which: str) -> Callable[[RowResult], float | None]:
        return lambda result: result.poses_mm.get(which, {}).get(error)

    return tuple(
        Column(f"poses: {name}, {which}, mm", of(which), 1, -1) for which in (GIVEN, TRAINED)
    )


def _defect(metric: str) -> tuple[Column, ...]:
    """A share of the person, of poses and cameras that the fit has not seen."""
    return tuple(
        _percent(metric, name, split, poses)
        for name, split, poses in (_TEST, _NOVEL_POSE, _NOVEL_VIEW)
    )


def _percent(metric: str, name: str, split: Split, poses: str | None) -> Column:
    of = score(metric, split, poses=poses)

    def percent(result: RowResult) -> float | None:
        share = of(result)
        return None if share is None else 100 * share

    return Column(f"defects: {metric}, %, {name}", percent, 2, -1)


def _surface(name: str, figure: str, key: str, moment: str) -> Column:
    """A figure of the surface at the last such moment of a fit."""

    def of(result: RowResult) -> float | None:
        there = [figures for figures in result.surface if figures.moment == moment]
        found = getattr(there[-1], figure) if there else None
        return found.get(key) if isinstance(found, dict) else found

    return Column(name, of, 2 if figure == "spacing" else 1, -1)


PSNR = _whole("psnr", 2, 1)
SSIM = _whole("ssim", 4, 1)
LPIPS, RAND_VGG = _whole("lpips", 4, -1), _whole("rand_vgg", 4, -1)
PARTS = (*_part("hands"), *_part("face"), *_part("person"), *_part("black"))
POSES = (
    *_millimetres("body", "body"),
    *_millimetres("body aligned", "body_aligned"),
    *_millimetres("hands aligned", "hands_aligned"),
    *_millimetres("feet aligned", "feet_aligned"),
)
SURFACE = (
    _surface("spacing at the end", "spacing", "all", "end"),
    _surface("of patterned cloth", "spacing", "patterned cloth", "end"),
    _surface("before the last re-initialisation", "spacing", "all", "before"),
    _surface("after it", "spacing", "all", "after"),
    _surface("bias of hair at the end, mm", "bias_mm", "hair", "end"),
    _surface("before the last re-initialisation, mm", "bias_mm", "hair", "before"),
    _surface("after it, mm", "bias_mm", "hair", "after"),
    _surface("bias of hem at the end, mm", "bias_mm", "hem", "end"),
    _surface("bias of accessories at the end, mm", "bias_mm", "accessories", "end"),
    _surface(
        "of accessories before the last re-initialisation, mm", "bias_mm", "accessories", "before"
    ),
    _surface("of accessories after it, mm", "bias_mm", "accessories", "after"),
    _surface("bias of the rest at the end, mm", "bias_mm", "rest", "end"),
)
DEFECTS = (
    *_defect("spill"),
    *_defect("holes"),
    _percent("flicker", "test", "test", None),
    _surface("stray Gaussians at the end, mm", "stray_mm", "", "end"),
    _surface("elongation of Gaussians", "elongation", "", "end"),
    _surface("largest Gaussian, mm", "largest_mm", "", "end"),
)
COST = (
    Column("seconds", lambda result: result.seconds, 0, -1),
    Column("Gaussians", lambda result: float(result.gaussians), 0, 0),
)
COLUMNS = (*PSNR, *SSIM, *LPIPS, *RAND_VGG, *PARTS, *POSES, *DEFECTS, *SURFACE, *COST)


def is_held_out(case: Case) -> bool:
    """Whether nothing was tuned on a case."""
    return case not in TUNING


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
    full = {r.case: column.of(r) for r in results if r.row == FULL.name}
    own = {r.case: column.of(r) for r in results if r.row == row}
    people = _means_of_people(own)
    if not len(people):
        return None
    pairs = {case: (x, full.get(case)) for case, x in own.items()}
    differences = _means_of_people(
        {case: x - whole for case, (x, whole) in pairs.items() if None not in (x, whole)}
    )
    return Figure(
        mean=float(people.mean()),
        spread=float(people.std()),
        worst=float(people.max() if column.better < 0 else people.min()),
        people=len(people),
        against_full=float(differences.mean()) if len(differences) else None,
    )


def _means_of_people(values: Mapping[Case, float | None]) -> np.ndarray:
    """The mean over the cases of each person, of those that have a figure."""
    people: dict[str, list[float]] = {}
    for case, value in values.items():
        if value is not None and math.isfinite(value):
            people.setdefault(case.take.name, []).append(value)
    return np.array([np.mean(own) for own in people.values()])
