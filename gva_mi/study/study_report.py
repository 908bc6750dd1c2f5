"""Pages of the two studies: their tables, each case, and for avatars pictures and the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Outcome
from gva_mi.study.page import Headline, Section, Table, write_page
from gva_mi.study.study_pictures import sections_of_pictures
from gva_mi.study.tables import STYLES, Cells, cell, group_of, text_table

PAPER = Table(
    ("the paper's Table 4", "PSNR, dB", "SSIM", "1000 LPIPS", "variant of the study"),
    (
        ("w/o pose refinement", "26.76", "0.978", "51.20", "without either"),
        ("w/o hand skeleton", "28.79", "0.982", "34.45", "without hand skeleton"),
        (
            "w/o surface-guided re-initialisation",
            "30.48", "0.989", "35.30", "without re-initialisation, naked",
        ),
        ("GVA, full", "32.22", "0.989", "31.80", "seeded on the naked body; full"),
    ),
)  # fmt: skip
_PAPER = (
    "Real people, other cameras, an A100: the differences between rows can be compared with the "
    "study's, the values cannot."
)
REFINE_TEXT = (
    "Changes of errors are relative: -50 % is half the error of stage 1. ‘Aligned’ errors are "
    "pelvis-aligned, those of fingers wrist-aligned. Depths of ankles and wrists are those after "
    "refinement, above zero if too far away. ‘Increased’ is the share of frames whose error "
    "increased. ‘IoU - limit’ compares with the ground-truth pose. Every error model counts once."
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


def tables(kind: str, cells: Cells) -> list[Table]:
    """Write the tables of a study: one for all columns of refinement, one a group for avatars."""
    names = [name for row in cells.values() for name in row]
    groups = [group for group in STYLES if any(group_of(name) == group for name in names)]
    if kind == "refine":
        return [text_table("error model", cells, groups)]
    return [text_table(group, cells, (group,), spread=True) for group in groups]


def write_study_report(
    path: Path,
    kind: str,
    outcomes: Sequence[Outcome],
    cells: Mapping[str, Cells],
    settings: dict[str, Any],
    pictures: Sequence[tuple[StudyCase, dict]] = (),
) -> None:
    """Write the page of a study.

    Args:
        path: the ``.html`` file.
        kind: "refine" or "avatar".
        outcomes: all that were asked for.
        cells: their summary, by the title of each table.
        settings: options and versions.
        pictures: finished runs by variant, of some cases.
    """
    text, first = (REFINE_TEXT if kind == "refine" else AVATAR_TEXT), next(iter(cells.values()))
    top = first.get("mean", next(iter(first.values()))) if first else {}
    shown = "change: aligned" if kind == "refine" else "psnr: "
    sections = []
    for title, own in cells.items():
        sections.append(Section(title.capitalize(), text, tables=tables(kind, own)))
        text = ""
    sections += sections_of_pictures(pictures)
    sections.append(_cases(outcomes, "change" if kind == "refine" else "psnr"))
    if kind == "avatar":
        sections.append(Section("The paper", _PAPER, tables=[PAPER]))
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
        kind = "held out" if outcome.case.held_out else "tuning"
        rows.append([outcome.case.name, kind, outcome.variant, *texts])
    head = ("case", "", "variant", *(name.rpartition(": ")[2] for name in names))
    return Section("Each case", f"{group.capitalize()} of each case.", tables=[Table(head, rows)])
