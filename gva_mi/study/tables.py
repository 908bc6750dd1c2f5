"""Tables and pages of both studies.

Figures of an outcome are named ``GROUP: TITLE``, and a name is a column: :data:`STYLES` says how
the figures of a group are written, and which of several is the worst. Others are kept in the file
only.

A subject counts once in a cell: the figures of its cases are averaged first. The refinement study
has a row for each error model (of :data:`LIMITS` for each case), their mean, and the worst of each
column; errors in mm, absolute and pelvis-aligned, have tables of their own. The avatar study has a
row for each variant, separately for held-out and tuned subjects, with the mean difference to the
variant "full" of the same cases, because subjects differ more than variants do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.study.engine import Outcome
from gva_mi.study.page import Headline, Section, Table, write_page
from gva_mi.study.pictures import ShownAvatar, picture_sections
from gva_mi.study.variants import FULL

TITLES = {  # of the avatar study's tables, by the purpose of cases
    "held out": "held-out subjects",
    "tuning": "subjects of the tuning set",
    "limits": "subject of the limits",
}
SHOWN = 2  # frames of a split of a case in pictures
REFINE_TEXT = (
    "Changes of errors are relative: -50 % is half the error of stage 1. ‘Aligned’ errors are "
    "pelvis-aligned, those of fingers wrist-aligned. Depths of ankles and wrists are those after "
    "refinement, above zero if too far away. ‘Increased’ is the share of frames whose error "
    "increased. ‘IoU - limit’ compares with the ground-truth pose, ‘IoU’ masks with true ones. "
    "Every error model counts once."
)
AVATAR_TEXT = (
    "Mean ± standard deviation over subjects, the worst subject, and in brackets the difference to "
    "full. ‘As given’: test frames without the poses that were trained. ‘Poses fitted’: to these "
    "very pictures, as GART reports. ‘Aligned’: after one similarity transform for the whole "
    "video, because one camera shows neither the scale nor the place of the world. Spacing is the "
    "coefficient of variation of the distance between Gaussians on the true surface (0 on a "
    "lattice, 0.52 for random points), bias the 95th percentile of the distance from the surface "
    "to the nearest Gaussian."
)
Worst = Callable[[Iterable[float]], float]


def _farthest(values: Iterable[float]) -> float:
    return max(values, key=abs)


MILLIMETRES = "absolute, mm", "aligned, mm"  # groups of refinement's errors before and after
STYLES: dict[str, tuple[str, Worst]] = {  # by the group of a figure
    "change": ("{:+.0%}", max),  # relative, of an error
    "depth": ("{:+.0f}", _farthest),
    **dict.fromkeys(MILLIMETRES, ("{:.0f}", max)),
    "frames": ("{:.0%}", max),
    "iou": ("{:+.3f}", min),
    "masks": ("{:.3f}", min),
    "time": ("{:.2f}", max),
    "psnr": ("{:.2f}", min),
    "cost": ("{:,.0f}", max),
    "ssim": ("{:.4f}", min),
    "lpips": ("{:.4f}", max),
    "rand_vgg": ("{:.4f}", max),
    "psnr in boxes": ("{:.2f}", min),
    "pose error, mm": ("{:.1f}", max),
    "surface": ("{:.2f}", max),
}


def group_of(name: str) -> str:
    """Return the group of a figure; empty if its name has none."""
    return name.rpartition(": ")[0]


@dataclass(frozen=True)
class Cell:
    """A figure over the subjects of a row."""

    mean: float
    std: float  # over subjects; 0 for one
    worst: float
    subjects: int
    against_full: float | None = None  # mean difference to "full" in the same cases

    def text(self, name: str, spread: bool = False) -> str:
        """Write the mean, and on request spread, worst and difference."""
        form, _ = STYLES[group_of(name)]
        mean = form.format(self.mean).replace("%", " %")
        if not spread:
            return mean
        worst = f", worst {form.format(self.worst)}" if self.subjects > 1 else ""
        digits = form.partition(".")[2][:1]
        against = "" if self.against_full is None else f" ({self.against_full:+.{digits}f})"
        return f"{mean} ± {self.std:.{digits}f}{worst}{against}"


Cells = dict[str, dict[str, Cell]]  # cells by row and name


def cell(outcomes: Sequence[Outcome], name: str, full: Sequence[Outcome] = ()) -> Cell | None:
    """Summarise a figure over outcomes of one row; None if no outcome has it.

    Args:
        outcomes: of the row.
        name: of the figure.
        full: outcomes of the variant "full", to compare with.
    """
    own = {outcome.case: outcome.figures.get(name) for outcome in outcomes}
    means = _subject_means((case.take.name, value) for case, value in own.items())
    if not len(means):
        return None
    base = {outcome.case: outcome.figures.get(name) for outcome in full}
    differences = _subject_means(
        (case.take.name, value - base[case])
        for case, value in own.items()
        if None not in (value, base.get(case))
    )
    against = float(differences.mean()) if len(differences) else None
    worst = float(STYLES[group_of(name)][1](means.tolist()))
    return Cell(float(means.mean()), float(means.std()), worst, len(means), against)


def _subject_means(values: Iterable[tuple[str, float | None]]) -> np.ndarray:
    """Average the finite values of each subject."""
    subjects: dict[str, list[float]] = {}
    for subject, value in values:
        if value is not None and math.isfinite(value):
            subjects.setdefault(subject, []).append(value)
    return np.array([np.mean(own) for own in subjects.values()])


def grouped(outcomes: Sequence[Outcome], key: Callable[[Outcome], str]) -> dict[str, list[Outcome]]:
    """Group outcomes by a name, in the order in which names appear."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return groups


def _row(group: Sequence[Outcome], full: Sequence[Outcome] = ()) -> dict[str, Cell]:
    names = dict.fromkeys(name for outcome in group for name in outcome.figures)
    cells = {name: cell(group, name, full) for name in names if group_of(name) in STYLES}
    return {name: cell for name, cell in cells.items() if cell is not None}


def refine_cells(outcomes: Sequence[Outcome]) -> dict[str, Cells]:
    """Summarise the refinement study: a row for each error model, then "mean" and "worst"."""
    families = grouped(outcomes, lambda outcome: outcome.case.row)
    cells = {row: _row(group) for row, group in families.items()}
    mean, worst = {}, {}
    for column in dict.fromkeys(column for row in cells.values() for column in row):
        means = [row[column].mean for row in cells.values() if column in row]
        farthest = float(STYLES[group_of(column)][1](means))
        mean[column] = Cell(float(np.mean(means)), float(np.std(means)), farthest, len(means))
        worst[column] = Cell(farthest, 0.0, farthest, 1)
    return {"error models": cells | {"mean": mean, "worst": worst}}


def avatar_cells(outcomes: Sequence[Outcome]) -> dict[str, Cells]:
    """Summarise the avatar study: for held-out and for tuned subjects, a row for each variant."""
    tables = {}
    for subjects, group in sorted(grouped(outcomes, lambda o: TITLES[o.case.purpose]).items()):
        rows = grouped(group, lambda outcome: outcome.variant)
        full = rows.get(FULL.name, ())
        tables[subjects] = {
            row: _row(own, () if own is full else full) for row, own in rows.items()
        }
    return tables


def to_json(cells: Cells) -> dict[str, dict[str, dict]]:
    """Return the cells as a study's file holds them."""
    return {row: {name: asdict(c) for name, c in own.items()} for row, own in cells.items()}


def tables(kind: str, cells: Cells) -> list[Table]:
    """Write the tables of a study: three for refinement, one a group for avatars."""
    there = {group_of(name) for row in cells.values() for name in row}
    groups = [group for group in STYLES if group in there]
    if kind == "refine":
        changes = [group for group in groups if group not in MILLIMETRES]
        first = _text_table("error model", cells, changes)
        return [first, *(_text_table(group, cells, (group,)) for group in MILLIMETRES)]
    return [_text_table(group, cells, (group,), spread=True) for group in groups]


def _text_table(title: str, cells: Cells, groups: Sequence[str], spread: bool = False) -> Table:
    """Write the cells of some groups as text, under a head that begins with ``title``."""
    names = dict.fromkeys(name for row in cells.values() for name in row)
    shown = [name for name in names if group_of(name) in groups]
    rows = [
        [row, *(own[name].text(name, spread) if name in own else "–" for name in shown)]
        for row, own in cells.items()
    ]
    return Table((title, *(name.rpartition(": ")[2] for name in shown)), rows)


def write_study_report(
    path: Path,
    kind: str,
    outcomes: Sequence[Outcome],
    cells: Mapping[str, Cells],
    settings: dict[str, Any],
    pictures: Iterable[tuple[str, Mapping[str, ShownAvatar]]] = (),
) -> None:
    """Write the page of a study.

    Args:
        path: the ``.html`` file.
        kind: "refine" or "avatar".
        outcomes: all that were asked for.
        cells: their summary, by the title of each table.
        settings: options and versions.
        pictures: names of some cases, and the avatars of their variants.
    """
    text, first = (REFINE_TEXT if kind == "refine" else AVATAR_TEXT), next(iter(cells.values()))
    top = first.get("mean", next(iter(first.values()))) if first else {}
    shown = "change: aligned" if kind == "refine" else "psnr: "
    sections = [
        Section(title.capitalize(), text, tables=tables(kind, own)) for title, own in cells.items()
    ]
    sections += picture_sections(pictures, SHOWN)
    sections.append(_cases(outcomes, "change" if kind == "refine" else "psnr"))
    subjects = len({outcome.case.take.name for outcome in outcomes})
    variants = dict.fromkeys(outcome.variant for outcome in outcomes)
    write_page(
        path,
        title=f"Study: {kind}",
        subtitle=f"Synthetic subjects: {subjects}. Variants: {', '.join(variants)}.",
        headlines=[
            Headline(found.text(name), name)
            for name, found in top.items()
            if name.startswith(shown)
        ],
        sections=sections,
        settings=settings,
    )


def _cases(outcomes: Sequence[Outcome], group: str) -> Section:
    """List every case and variant."""
    names = dict.fromkeys(n for o in outcomes for n in o.figures if group_of(n) == group)
    rows = []
    for outcome in outcomes:
        values = {name: cell([outcome], name) for name in names}
        texts = ("–" if x is None else x.text(name) for name, x in values.items())
        rows.append([outcome.case.name, outcome.case.purpose, outcome.variant, *texts])
    head = ("case", "", "variant", *(name.rpartition(": ")[2] for name in names))
    return Section("Each case", f"{group.capitalize()} of each case.", tables=[Table(head, rows)])
