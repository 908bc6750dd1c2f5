"""The page of a study, and its tables.

A subject counts once in a cell of a study's table: the figures of its cases are averaged first. The
refinement study has a row for each error model (of ``LIMITS`` for each case), their mean, and the
worst of each column. The avatar study has a row for each variant, separately for held-out and tuned
subjects, with the mean difference to the variant "full" of the same cases, because subjects differ
more than variants do. The relighting study has a row for each light. With
``--repeats``, a difference has its standard error over runs that differ by one ulp, and ≈ before it
if it is less than twice that: no more than chance.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.evaluate.figures import METRICS, Table, pivot, table, where
from gva_mi.evaluate.page import Section, write_page
from gva_mi.study.engine import Outcome
from gva_mi.study.refine_study import STAGE_1
from gva_mi.study.variants import FULL

TEXTS = {  # of the sections, by the title of their tables
    "error models": "Changes of errors are relative: -50 % is half the error of stage 1. Depths "
    "are measured after refinement, and above zero if too far away. ‘Increased’ is the share of "
    "frames whose error increased. Every error model counts once.",
    "held out subjects": "Mean ± standard deviation over subjects, the worst subject, and in "
    "brackets the difference to full.",
    "lights, held out subjects": "Means over subjects. Rows are lights that the video does not "
    "have, but for the usual one; one gain a channel is fitted to each subject's frames.",
}
REFINE_SHOWN = (  # a study's tables
    "change", "stage 1 error, mm", "refined error, mm", "refined depth, mm", "increased",
    "IoU - limit", "mask IoU", "s a frame",
)  # fmt: skip
AVATAR_SHOWN = (  # metrics, and regions unless all are
    ("PSNR, dB", ("white",)), ("PSNR, dB", ("person", "hands", "face")), ("SSIM", ("white",)),
    ("LPIPS", ("white",)), ("rand_vgg", ("white",)), ("given error, mm", ()),
    ("trained error, mm", ()), ("spacing", ()), ("bias, mm", ()), ("stray, mm", ()),
    ("area, m²", ()), ("open edges", ()), ("seconds", ()), ("Gaussians", ()),
)  # fmt: skip


def study_tables(kind: str, outcomes: Sequence[Outcome]) -> dict[str, list[Table]]:
    """Summarise a study, ``refine``, ``avatar`` or ``relight``: tables by their common title."""
    if kind == "refine":
        variants = dict.fromkeys(outcome.variant for outcome in outcomes)
        tables = {} if len(variants) < 2 else {"methods": _method_tables(outcomes)}
        for name in variants:
            title = f"error models, {name}" if tables else "error models"
            tables[title] = _refine_tables([o for o in outcomes if o.variant == name])
        return tables
    title, tables = {"avatar": ("", _avatar_tables), "relight": ("lights, ", _light_tables)}[kind]
    return {
        f"{title}{purpose} subjects": tables([o for o in outcomes if o.case.purpose == purpose])
        for purpose in sorted({outcome.case.purpose for outcome in outcomes})
    }


def _method_tables(outcomes: Sequence[Outcome]) -> list[Table]:
    """Return errors with a row for stage 1 and for each method, over the cases that all have."""
    variants = dict.fromkeys(outcome.variant for outcome in outcomes)
    having = lambda case: {outcome.variant for outcome in outcomes if outcome.case == case}
    figures = []
    for outcome in outcomes:
        if having(outcome.case) != set(variants):
            continue
        for figure in outcome.figures:
            stage, _, metric = figure.metric.partition(" error")
            row = STAGE_1 if stage == STAGE_1 else outcome.variant
            named = f"error{metric}" if metric else figure.metric
            about = {"subject": outcome.case.take.name, "variant": row, "metric": named}
            figures.append(replace(figure, **about))
    figures.sort(key=lambda figure: figure.variant != STAGE_1)
    tables = []
    for metric in ("error, mm", "increased"):
        cells = pivot(where(figures, metric=metric), ("variant",), ("alignment", "region"))
        tables.append(table(cells, metric))
    return tables


def _light_tables(outcomes: Iterable[Outcome]) -> list[Table]:
    """Return a table for each region, with a row for each light and a column for each way."""
    figures = [
        replace(figure, subject=outcome.case.take.name)
        for outcome in outcomes
        for figure in outcome.figures
    ]
    by_region = {x: where(figures, region=x) for x in dict.fromkeys(f.region for f in figures)}
    return [
        table(pivot(rows, ("variant",), ("alignment",)), f"PSNR, dB, {region}")
        for region, rows in by_region.items()
    ]


def _refine_tables(outcomes: Iterable[Outcome]) -> list[Table]:
    """Return tables with a row for each error model, then their mean and the worst."""
    figures = [
        replace(figure, subject=outcome.case.take.name, variant=outcome.case.row)
        for outcome in outcomes
        for figure in outcome.figures
    ]
    tables = []
    for metric in REFINE_SHOWN:
        cells = pivot(where(figures, metric=metric), ("variant",), ("alignment", "region"))
        means, worst = {}, {}
        for column in dict.fromkeys(column for row in cells.values() for column in row):
            of_rows = [float(row[column].mean()) for row in cells.values() if column in row]
            means[column] = np.array(of_rows)
            worst[column] = np.array([METRICS[metric].worst(of_rows)])
        if cells:
            tables.append(table(cells | {("mean",): means, ("worst",): worst}, metric))
    return tables


def _avatar_tables(outcomes: Iterable[Outcome]) -> list[Table]:
    """Return tables with a row for each variant, and differences to "full" in the same cases."""
    figures, differences, errors, tables = [], [], [], []
    for outcome in outcomes:
        figures += [figure for figure in outcome.figures if figure.split != "train"]
    key = lambda f: replace(f, variant=FULL.name, value=None, spread=None, runs=1)
    full = {key(f): f for f in figures if f.variant == FULL.name}
    for f in figures:
        if f.variant != FULL.name and key(f) in full and None not in (f.value, full[key(f)].value):
            one = full[key(f)]
            differences.append(replace(f, value=f.value - one.value))
            if None not in (f.spread, one.spread):
                error = f.spread**2 / f.runs + one.spread**2 / one.runs
                errors.append(replace(f, value=error))
    people = {outcome.case.name: outcome.case.take.name for outcome in outcomes}
    for metric, regions in AVATAR_SHOWN:
        about = {"metric": metric} | ({"region": regions} if regions else {})
        cells, against, squares = (
            pivot(
                [replace(f, subject=people[f.subject]) for f in where(some, **about)],
                ("variant",),
                ("split", "alignment", "region"),
            )
            for some in (figures, differences, errors)
        )
        write = lambda row, column, values, known=against, chance=squares: spread_text(
            values, column[-1], known.get(row, {}).get(column), chance.get(row, {}).get(column)
        )
        if cells:
            tables.append(table(cells, metric, write))
    return tables


def spread_text(
    values: np.ndarray,
    metric: str,
    against: np.ndarray | None,
    squares: np.ndarray | None = None,
) -> str:
    """Write mean and spread over subjects, the worst subject, and the difference to "full".

    ``squares`` are the squared standard errors of the differences over runs, one a subject.
    """
    form, worst = METRICS[metric].form, METRICS[metric].worst
    text = f"{values.mean():{form}} ± {values.std():{form}}"
    if len(values) > 1:
        text += f", worst {worst(values.tolist()):{form}}"
    if against is None:
        return text
    difference = against.mean()
    if squares is None:
        return f"{text} ({difference:+{form}})"
    error = float(np.sqrt(squares.sum()) / len(squares))
    chance = "≈ " if abs(difference) < 2 * error else ""
    return f"{text} ({chance}{difference:+{form}} ± {error:{form}})"


def write_study_report(
    path: Path, kind: str, outcomes: Sequence[Outcome], settings: dict[str, Any]
) -> None:
    """Write the page of a study.

    Args:
        path: the ``.html`` file.
        kind: "refine", "avatar" or "relight".
        outcomes: all that were asked for.
        settings: options and versions.
    """
    shown = "change" if kind == "refine" else "PSNR, dB"
    sections = [
        Section(name.capitalize(), tables=tables, text=TEXTS.get(name, ""))
        for name, tables in study_tables(kind, outcomes).items()
    ]
    own = [f for o in outcomes for f in o.figures if f.metric == shown and f.split != "train"]
    each = table(pivot(own, ("subject", "variant"), ("split", "alignment", "region")), "case")
    sections.append(Section("Each case", tables=[each], text=f"{shown} of each case."))
    purposes = ", ".join(sorted({outcome.case.purpose for outcome in outcomes}))
    subjects = len({outcome.case.take.name for outcome in outcomes})
    variants = ", ".join(dict.fromkeys(outcome.variant for outcome in outcomes))
    write_page(
        path,
        title=f"Study: {kind}",
        subtitle=f"Synthetic subjects: {subjects} ({purposes}). Variants: {variants}.",
        sections=sections,
        settings=settings,
    )
