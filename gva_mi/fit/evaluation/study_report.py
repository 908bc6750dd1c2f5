"""The page of the study: its tables, the paper's beside, and pictures like the paper's figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gva_mi.fit.evaluation.paper import TABLES
from gva_mi.fit.evaluation.report import surface_table
from gva_mi.fit.evaluation.rows import FULL
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.fit.evaluation.study_pictures import CaseRuns, sections_of_pictures
from gva_mi.fit.evaluation.summary import (
    COST,
    DEFECTS,
    LPIPS,
    PARTS,
    POSES,
    PSNR,
    RAND_VGG,
    SSIM,
    SURFACE,
    Column,
    by_people,
    figure,
    is_held_out,
)
from gva_mi.page import Figure, Section, Table, write_page

TITLES = (
    ("PSNR, dB, whole picture on white", (*PSNR, *COST)),
    ("SSIM", SSIM),
    ("LPIPS", LPIPS),
    ("rand_vgg", RAND_VGG),
    ("PSNR, dB, in the boxes of hands, face and person, and on black", PARTS),
    ("Errors of the poses, as given and trained along", POSES),
    ("Defects: what spills over the outline, holes within it, flicker, strays", DEFECTS),
    ("Where the Gaussians lie", SURFACE),
)


def write_study_report(
    path: Path, results: Sequence[RowResult], runs: Sequence[CaseRuns], settings: dict[str, Any]
) -> None:
    """Write the page.

    Args:
        path: of it.
        results: all that were asked for.
        runs: of the cases that are shown in pictures.
        settings: options and versions.
    """
    rows = list(dict.fromkeys(result.row for result in results))
    people = len({result.case.take.name for result in results})
    write_page(
        path,
        title="The avatar, row by row",
        subtitle=(
            f"{people} people, {len(rows)} ways to make an avatar of each. Mean ± standard "
            "deviation over people, the worst of them, and in brackets the difference to full."
        ),
        figures=list(_large(results)),
        sections=[
            *_tables(results),
            *sections_of_pictures(runs),
            _people(results),
            _surface(results),
            _paper(),
        ],
        settings=settings,
    )


def table(results: Sequence[RowResult], columns: Sequence[Column]) -> Table:
    """A line for each row of the study; columns that nobody has are left out.

    A cell holds mean ± standard deviation over people, the worst one, and the difference to the row
    "full".
    """
    shown = [c for c in columns if any(c.of(result) is not None for result in results)]
    rows = dict.fromkeys(result.row for result in results)
    lines = [[row, *(_cell(results, row, column) for column in shown)] for row in rows]
    return Table(("row", *(column.name.split(": ", 1)[-1] for column in shown)), lines)


def _cell(results: Sequence[RowResult], row: str, column: Column) -> str:
    found, digits = figure(results, row, column), column.digits
    if found is None:
        return "–"
    text = f"{found.mean:,.{digits}f} ± {found.spread:.{digits}f}"
    if found.people > 1 and column.better:
        text += f", worst {found.worst:,.{digits}f}"
    if row == FULL.name or found.against_full is None:
        return text
    return f"{text} ({found.against_full:+.{digits}f})"


def _large(results: Sequence[RowResult]) -> Iterator[Figure]:
    """The row "full" at the top."""
    group = next(iter(by_people(results).items()), None)
    for column in PSNR:
        found = figure(group[1], FULL.name, column) if group else None
        if found is not None:
            label = f"{column.name.split(': ')[-1]}, mean of {found.people} {group[0]}"
            yield Figure(f"{found.mean:.1f} dB", label)


def _tables(results: Sequence[RowResult]) -> Iterator[Section]:
    text = (
        "‘As given’ are test frames without the poses that were trained along; ‘fitted’ those "
        "under poses that were fitted to these very pictures, as GART reports; ‘aligned’ after one "
        "similarity transform for the whole video, for one camera does not tell how large the "
        "world is and where. A person counts once, whatever noises were drawn over their video."
    )
    for people, group in by_people(results).items():
        tables = [(title, table(group, columns)) for title, columns in TITLES]
        for title, made in tables:
            if len(made.head) > 1:
                yield Section(f"{title}: {people}", text, tables=[made])
                text = ""


def _people(results: Sequence[RowResult]) -> Section:
    """The first figures, person by person and noise by noise."""
    columns = [c for c in (*PSNR, *COST) if any(c.of(result) is not None for result in results)]
    lines = []
    for result in results:
        values = [(column.of(result), column.digits) for column in columns]
        lines.append([
            result.case.name, "held out" if is_held_out(result.case) else "tuned on", result.row,
            *("–" if value is None else f"{value:,.{digits}f}" for value, digits in values),
        ])  # fmt: skip
    head = ("case", "", "row", *(c.name.split(": ")[-1] for c in columns))
    return Section("Each case", "PSNR in dB, whole picture on white.", tables=[Table(head, lines)])


def _surface(results: Sequence[RowResult]) -> Section:
    """How the Gaussians of one person lie, over the steps of some rows."""
    shown = [result for result in results if result.case == results[0].case and result.surface]
    text = (
        f"{results[0].case.name}: spacing is the coefficient of variation of the distance to the "
        "nearest Gaussian on the true surface (0 on a lattice, 0.52 strewn at random), which tells "
        "unbalanced aggregation; bias is the 95th percentile of the distance from the true surface "
        "to the nearest Gaussian. In the order of: " + ", ".join(result.row for result in shown)
    )
    tables = [surface_table(result.surface) for result in shown]
    return Section("Figure 2 in figures", text, tables=tables)


def _paper() -> Section:
    text = (
        "The paper's own tables, as a reference: real people, other cameras, an A100. The "
        "differences between rows can be compared with the study's, the values cannot."
    )
    tables = [Table((t.title, *t.head[1:]), t.rows) for t in TABLES]
    return Section("The paper", text, tables=tables)
