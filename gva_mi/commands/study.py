"""The command ``gva-mi study``: how well a step does on people and noise it was not tuned on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.commands.arguments import Flat, Switch
from gva_mi.console import bar, say
from gva_mi.errors import InputError
from gva_mi.pose.evaluation.cases import HELD_OUT, TUNING, Case
from gva_mi.pose.evaluation.study import CaseResult, StudyOptions
from gva_mi.pose.evaluation.study import study as refine_cases
from gva_mi.pose.evaluation.study_file import load_study, save_study
from gva_mi.pose.evaluation.summary import COLUMNS, rows_of
from gva_mi.pose.parallel import workers as local_workers

CASES = {"held-out": HELD_OUT, "tuning": TUNING, "all": (*TUNING, *HELD_OUT)}


def study(
    what: Positional[Literal["refine"]],
    options: Flat[StudyOptions],
    *,
    out: Path,
    cases: Literal["held-out", "tuning", "all"] = "held-out",
    families: tuple[str, ...] = (),
    people: tuple[str, ...] = (),
    workers: int = 1,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Refine several synthetic people and print how far their poses are from the truth.

    Errors are shares by which refinement changed them; depths are those of refined ankles and
    wrists, above zero where they are too far away. A study that was cut short goes on where it was.

    Args:
        what: the step that is studied; its figures are written to a file of its name, refine.json.
        options: how large the study is.
        out: folder for that file, and for the subjects, which are made where they are missing.
        cases: people the refinement was not tuned on, those it was, or all.
        families: of noise; all without it.
        people: names of the study's subjects, or seeds; all without it.
        workers: processes on this machine; any number gives the same bits.
        body: a body in SMPL-X's .npz format; without it the built-in puppet.
        overwrite: compute the cases again that the file holds.
    """
    figures = out / f"{what}.json"
    model = load_body(body)
    chosen = _chosen(CASES[cases], families, people)
    known = [] if overwrite else load_study(figures, model, options)
    asked = [r for r in known if r.case in chosen and r.noise in options.noise]
    others = [r for r in known if r not in asked]
    if asked:
        say(f"{len(asked)} cases are in {figures}; --overwrite computes them again")
    results = []
    with bar("study") as progress, local_workers(workers) as executor:
        for result in refine_cases(out, chosen, model, options, asked, progress, executor):
            results.append(result)
            done = {(r.case, r.noise) for r in results}
            waiting = [r for r in asked if (r.case, r.noise) not in done]
            save_study(figures, results, model, options, [*waiting, *others])
    for line in _table(results):
        say(line)
    say(f"figures: {figures}")


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


def _table(results: Sequence[CaseResult]) -> Iterator[str]:
    """A line for each family, their mean, and the worst of each column."""
    head = ("family", "cases", *(column.name for column in COLUMNS))
    lines = [head, *(row.cells() for row in rows_of(results))]
    widths = [max(len(cell) for cell in column) for column in zip(*lines, strict=True)]
    for first, *others in lines:
        padded = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  ".join([first.ljust(widths[0]), *padded]).rstrip()
