"""The command ``gva-mi study``: how well a step does on people and noise it was not tuned on."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg, subcommand

from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.commands.arguments import Flat, Switch
from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.files import require_writable, versions
from gva_mi.fit.evaluation.rows import Row, rows_named
from gva_mi.fit.evaluation.study import AvatarStudyOptions, RowResult, row_runs
from gva_mi.fit.evaluation.study import study as fit_rows
from gva_mi.fit.evaluation.study_file import load_results, save_results
from gva_mi.fit.evaluation.study_pictures import CaseRuns
from gva_mi.fit.evaluation.study_report import table, write_study_report
from gva_mi.fit.evaluation.summary import COST, PSNR, by_people
from gva_mi.lock import alone_in
from gva_mi.pose.evaluation.cases import TUNING, Case, held_out
from gva_mi.pose.evaluation.study import CaseResult, StudyOptions
from gva_mi.pose.evaluation.study import study as refine_cases
from gva_mi.pose.evaluation.study_file import load_study, save_study
from gva_mi.pose.evaluation.summary import COLUMNS, rows_of
from gva_mi.pose.parallel import workers as local_workers
from gva_mi.ranges import Within, Workers, require_ranges

IN_PICTURES = 3  # cases that the avatar's page shows


@dataclass(frozen=True)
class Choice:
    """What both studies are asked for."""

    out: Path  # folder for figures, and for the subjects, which are made where they are missing
    cases: Literal["held-out", "tuning", "all"] = "held-out"  # people it was not tuned on, or was
    # Of the held-out people and noises: who has chosen by one takes the next.
    edition: Annotated[int, Within(1, 1000)] = 1
    families: tuple[str, ...] = ()  # of noise; all without it
    people: tuple[str, ...] = ()  # names of the study's subjects, or seeds; all without it
    workers: Workers = 1  # processes on this machine; any number gives the same bits
    body: Path | None = None  # a body in SMPL-X's .npz format; without it the built-in puppet
    overwrite: Switch = False  # compute again what the file of figures holds

    def __post_init__(self) -> None:
        require_ranges("study", self)

    @property
    def asked_for(self) -> tuple[Case, ...]:
        """The cases of which families and people are chosen."""
        judging = held_out(self.edition)
        return {"held-out": judging, "tuning": TUNING, "all": (*TUNING, *judging)}[self.cases]


@dataclass(frozen=True)
class RefineStudy(Choice):
    """Refine several synthetic people and print how far their poses are from the truth.

    Errors are shares by which refinement changed them; depths are those of refined ankles and
    wrists, above zero where they are too far away. A study that was cut short goes on where it was.
    """

    options: Flat[StudyOptions] = field(default_factory=StudyOptions)


@dataclass(frozen=True)
class AvatarStudy(Choice):
    """Fit avatars of several synthetic people: the method, and the same without each of its parts.

    Writes avatar.json and avatar.html: PSNR, SSIM, perceptual figures on test frames, novel poses
    and novel views, errors of poses, how the Gaussians lie, time; mean, spread and worst over
    people, the paper's tables beside. A study that was cut short goes on where it was.
    """

    rows: tuple[str, ...] = ()  # of the table, such as full or "with residual"; all without it
    options: Flat[AvatarStudyOptions] = field(default_factory=AvatarStudyOptions)


def study(
    what: Annotated[
        Annotated[RefineStudy, subcommand("refine", prefix_name=False)]
        | Annotated[AvatarStudy, subcommand("avatar", prefix_name=False)],
        arg(name=""),
    ],
) -> None:
    """How well a step does on people, and families of noise, that it was not tuned on.

    Args:
        what: the step that is studied; its figures are written to a file of its name.
    """
    model = load_body(what.body)
    chosen = _chosen(what.asked_for, what.families, what.people)
    rows = () if isinstance(what, RefineStudy) else rows_named(what.rows)
    with alone_in(what.out, "gva-mi study"):
        require_writable(what.out)
        if isinstance(what, RefineStudy):
            _study_refinement(what, chosen, model)
        else:
            _study_avatar(what, chosen, model, rows)


def _study_refinement(asked: RefineStudy, chosen: Sequence[Case], model: BodyModel) -> None:
    figures, options = asked.out / "refine.json", asked.options
    known = [] if asked.overwrite else load_study(figures, model, options)
    there = [r for r in known if r.case in chosen and r.noise in options.noise]
    others = [r for r in known if r not in there]
    if there:
        say(f"{len(there)} cases are in {figures}; --overwrite computes them again")
    results = []
    with bar("study") as progress, local_workers(asked.workers) as executor:
        for result in refine_cases(asked.out, chosen, model, options, there, progress, executor):
            results.append(result)
            done = {(r.case, r.noise) for r in results}
            waiting = [r for r in there if (r.case, r.noise) not in done]
            save_study(figures, results, model, options, [*waiting, *others])
    for line in _refinement_lines(results):
        say(line)
    say(f"figures: {figures}")


def _study_avatar(
    asked: AvatarStudy, chosen: Sequence[Case], model: BodyModel, rows: Sequence[Row]
) -> None:
    figures, page, options = asked.out / "avatar.json", asked.out / "avatar.html", asked.options
    made_with, wanted = options.made_with(model), {row.name for row in rows}
    try:
        known = load_results(figures, made_with)
    except InputError:
        if not asked.overwrite:
            raise
        known = []
    there = [r for r in known if r.case in chosen and r.row in wanted]
    others = [r for r in known if r not in there]
    if asked.overwrite:
        there = []
        for run in row_runs(asked.out, [(c, row) for c in chosen for row in rows], model, options):
            shutil.rmtree(run.out, ignore_errors=True)
    if there:
        say(f"{len(there)} rows are in {figures}; --overwrite computes them again")
    results: list[RowResult] = []
    with bar("study") as progress, local_workers(asked.workers) as executor:
        found = fit_rows(asked.out, chosen, rows, model, options, there, progress, executor)
        for result in found:
            results.append(result)
            done = {(r.case, r.row) for r in results}
            waiting = [r for r in there if (r.case, r.row) not in done]
            save_results(figures, results, made_with, [*waiting, *others])
    for people, group in by_people(results).items():
        say(f"{people}: PSNR in dB on white")
        made = table(group, (*PSNR, *COST))
        for line in _lines([made.head, *made.rows]):
            say(line)
    shown = []
    for case in chosen[:IN_PICTURES]:
        runs = row_runs(asked.out, [(case, row) for row in rows], model, options)
        finished = {run.row.name: run for run in runs if run.is_done}
        shown.append(CaseRuns(case.name, finished))
    write_study_report(page, results, shown, {**made_with, "versions": versions()})
    say(f"figures: {figures}; page: {page}")


def _chosen(cases: Sequence[Case], families: Sequence[str], people: Sequence[str]) -> list[Case]:
    """The cases of some families and people, without those that lack a package."""
    for name, asked, there in (
        ("families", families, [case.family for case in cases]),
        ("people", people, [case.take.person for case in cases]),
    ):
        for one in asked:
            if one not in there:
                known = ", ".join(dict.fromkeys(there))
                raise InputError(f"study: --{name} has no '{one}'; in these cases are: {known}")
    chosen = []
    for case in cases:
        if families and case.family not in families or people and case.take.person not in people:
            continue
        if case.lacks is not None:
            say(f"{case.name}: left out, for the package {case.lacks} is not installed")
            continue
        chosen.append(case)
    if not chosen:
        raise InputError("study: no case is of these families and these people at once")
    return chosen


def _refinement_lines(results: Sequence[CaseResult]) -> Iterator[str]:
    """A line for each family, their mean, and the worst of each column."""
    head = ("family", "cases", *(column.name for column in COLUMNS))
    return _lines([head, *(row.cells() for row in rows_of(results))])


def _lines(cells: Sequence[Sequence[str]]) -> Iterator[str]:
    """A table's lines, its columns below each other."""
    widths = [max(len(cell) for cell in column) for column in zip(*cells, strict=True)]
    for first, *others in cells:
        padded = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  ".join([first.ljust(widths[0]), *padded]).rstrip()
